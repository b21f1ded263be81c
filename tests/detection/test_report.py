"""Outcomes of pulses, and returns that are left out, on numpy."""

import numpy as np

from lidarscene.detection.outcomes import Outcome, Status
from lidarscene.detection.report import Detection, Returns, outcome_of, without_pulses, without_returns


def returns(status, reported):
    """Returns of a stop with these causes."""
    zero = np.zeros(len(status))
    return Returns(
        reported=np.asarray(reported, bool), status=np.asarray(status), range_m=zero, amplitude=zero, intensity=zero
    )


def detection(*stops):
    """Pulses that met a surface and tripped the comparator within the window."""
    yes, zero = np.ones(len(stops[0].range_m), bool), np.zeros(len(stops[0].range_m))
    outcome = outcome_of(stops, has_surface=yes, tripped=yes, in_window=yes)
    return Detection(snr=zero, detection_probability=zero, outcome=outcome, ambient=zero, stops=stops)


def test_the_first_stage_at_which_an_echo_is_lost_names_the_outcome():
    """The pulses are lost at all later stages too."""
    stop = returns([Status.ECHO] * 5, [True, False, False, False, False])
    outcome = outcome_of(
        [stop],
        has_surface=np.array([True, True, True, True, False]),
        tripped=np.array([True, True, True, False, False]),
        in_window=np.array([True, True, False, False, False]),
    )
    lost = [Outcome.HIDDEN, Outcome.OUT_OF_WINDOW, Outcome.BELOW_THRESHOLD, Outcome.NO_SURFACE]
    assert outcome.tolist() == [Outcome.KEPT, *lost]


def test_only_an_echo_of_a_surface_keeps_a_pulse():
    """A folded echo is one; light of the air, of other channels and of other lidars, noise and ghosts are none."""
    stop = returns(list(Status), [True] * len(Status))
    kept = detection(stop).outcome == Outcome.KEPT
    assert [status for status, is_kept in zip(Status, kept, strict=True) if is_kept] == [Status.ECHO, Status.ALIASED]


def test_a_pulse_is_hidden_with_its_last_echo():
    """Three pulses of two returns: without the alarm, without one of two echoes, and without the only echo."""
    first = returns([Status.FALSE_ALARM, Status.ECHO, Status.ECHO], [True, True, True])
    second = returns([Status.ECHO] * 3, [True, True, False])
    left = without_returns(detection(first, second), [np.ones(3, bool), np.zeros(3, bool)])
    assert left.outcome.tolist() == [Outcome.KEPT, Outcome.KEPT, Outcome.HIDDEN]
    assert [stop.reported.tolist() for stop in left.stops] == [[False] * 3, [True, True, False]]


def test_pulses_that_are_left_out_count_as_without_a_surface():
    """Whatever they were."""
    stop = returns([Status.ECHO, Status.ECHO, Status.FALSE_ALARM], [True, True, True])
    left = without_pulses(detection(stop), np.array([True, False, True]))
    assert left.outcome.tolist() == [Outcome.NO_SURFACE, Outcome.KEPT, Outcome.NO_SURFACE]
    assert left.stops[0].reported.tolist() == [False, True, False]
