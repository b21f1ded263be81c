"""Who moves along a street: vehicles on lanes, vehicles and people who cross, people who walk.

Vehicles follow each other by the intelligent driver model (Treiber, Hennecke and Helbing, Phys. Rev. E 62 (2000), 1805)
(T173, T174), here with steps of `STEP_S`. A crossing at which others cross is closed as the ego vehicle comes near. Who
cannot stop any more drives on; the others wait at the stop line, as behind a vehicle that stands. Those who cross go
once nobody is on the crossing, nor about to be, and it opens when they are through. So nobody meets anybody, whatever
is drawn (`tests/scene/street`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ...maths.arrays import Numbers
from .centre_line import CentreLine
from .layout import CAR_M, CROSS_LANE_M, LEAST_SHARE, QUEUE_M, Crossing, Layout
from .polylines import integral
from .shapes import LANE_ROOM_M, draw_vehicle, vehicle_length_m

STEP_S = 0.1
"""Accuracy bought: step of the driver model, a fifteenth of a driver's headway."""

POSE_STEPS = 5
"""Steps from pose to pose of a motion."""

ACCELERATION_M_S2, BRAKING_M_S2, HARDEST_M_S2 = 1.5, 2.0, 6.0
"""Choice: of a driver: comfortable acceleration, comfortable braking, hardest braking."""

HEADWAY_S, STANDING_GAP_M = 1.5, 2.5
"""Choice: of a driver: time to the vehicle ahead, distance to it in a queue."""

WILLING_M_S2 = 3.5
"""Choice: braking beyond which nobody stops at a line that closes: they drive on."""

WALK_M_S = (1.1, 1.6)
"""Choice: slowest and fastest speed of people who walk, of which each draws one."""

CIRCLE_M = 0.9
"""Source: G. L. Brown, N. Seethapathi and M. Srinivasan, PNAS 118 (2021), 29: people take a circle of radius r at
1 / sqrt(1 + (r_0 / r)^2) of their speed, so with v^2 / (2 r_0) sideways at most; r_0 as remembered, so assumed."""

SLOWING_M_S2, WALK_STEP_M, BETWEEN_M = 1.0, 0.05, 5.0
"""Choice: of people who walk: acceleration before and behind a turn, step of their way, and distance of the last from
the first."""

INSIDE_M = 2.5
"""Choice: least distance of people who walk one after the other, with prams too, on the inner side of a bend."""

TURN_S = 2.0
"""Choice: time in which those who have crossed turn round."""

CYCLIST_SHARE = 0.45
"""Choice: speed that a cyclist wants, over that of a driver."""

CROSS_M_S = 9.0
"""Choice: speed of vehicles on the streets that cross."""

CLEAR_S = 1.0
"""Choice: time for which a crossing must have been clear before others cross, and after which it opens again."""


class Track(NamedTuple):
    """Way of one that moves: times [s], and at these x, y [m] and yaw [degrees], along the street and against it.

    Attributes:
        name: of the body whose instance it is
    """

    name: str
    time_s: Numbers
    x_m: Numbers
    y_m: Numbers
    yaw_deg: Numbers

    def between(self, first: int, last: int) -> Track:
        """The track from one of its times to another, with a pose every `POSE_STEPS` steps."""
        rows = np.append(np.arange(first, last, POSE_STEPS), last)
        return Track(self.name, *(each[rows] for each in (self.time_s, self.x_m, self.y_m, self.yaw_deg)))


def _track(name: str, time_s: Numbers, *state: Numbers | float) -> Track:
    """Track of one whose x, y or yaw may be the same all the time."""
    return Track(name, time_s, *(np.broadcast_to(each, time_s.shape) for each in state))


class Traffic(NamedTuple):
    """All that moves along a street."""

    ego: Track
    others: Sequence[Track]


@dataclass(slots=True, eq=False)
class _Lane:
    """Vehicles on one lane, the first one ahead; places along the direction of travel, by its own way in bends.

    Attributes:
        line: middle of the street
        y_m: of the lane
        front_m: (n,) place of each vehicle's front, lap after lap on a loop
        speed_m_s: (n,) speed of each vehicle
        desired_m_s: (n,)
        lengths_m: (n,) of the vehicles
        loop_m: length of a loop, on which the last vehicle is ahead of the first; infinite on an open street
        limit_m_s: places along the direction, and the speed that bends allow there
    """

    line: CentreLine
    y_m: float
    direction: int
    front_m: Numbers
    speed_m_s: Numbers
    desired_m_s: Numbers
    lengths_m: Numbers
    names: list[str]
    loop_m: float = math.inf
    limit_m_s: tuple[Numbers, Numbers] = (np.zeros(1), np.full(1, np.inf))
    history: list[Numbers] = field(default_factory=list)

    def way_m(self, *x_m: float) -> list[float]:
        """Places on the lane, of those along the street."""
        return [float(each) for each in self.direction * self.line.way_beside_m(np.array(x_m), self.y_m)]

    def lines_m(self, crossing: Crossing) -> list[float]:
        """Stop line and far edge of a crossing."""
        return self.way_m(crossing.stop_x_m(self.direction), crossing.stop_x_m(-self.direction))

    def step(self, closed_m: Sequence[float], end_m: float) -> None:
        """Drive on for a step; ``closed_m`` are stop lines that are closed, along the direction of travel."""
        is_loop = math.isfinite(self.loop_m)
        rear_m = self.front_m - self.lengths_m
        ahead_m = np.concatenate([[rear_m[-1] + self.loop_m if is_loop else end_m], rear_m[:-1]])
        ahead_m_s = np.concatenate([[self.speed_m_s[-1] if is_loop else 0.0], self.speed_m_s[:-1]])
        for line_m in closed_m:
            place_m = self.front_m + self.room_m(line_m)
            waits = self.will_stop(line_m) & (place_m < ahead_m)
            # A line stands for a vehicle whose rear is a queue's gap behind it.
            ahead_m = np.where(waits, place_m + 0.6 * STANDING_GAP_M, ahead_m)
            ahead_m_s = np.where(waits, 0.0, ahead_m_s)
        middle_m = self.front_m - 0.5 * self.lengths_m
        if is_loop:
            middle_m = self.limit_m_s[0][0] + np.mod(middle_m - self.limit_m_s[0][0], self.loop_m)
        acceleration = driver_acceleration_m_s2(
            speed_m_s=self.speed_m_s,
            desired_m_s=np.minimum(self.desired_m_s, np.interp(middle_m, *self.limit_m_s)),
            gap_m=ahead_m - self.front_m,
            closing_m_s=self.speed_m_s - ahead_m_s,
        )
        speed_m_s = np.maximum(self.speed_m_s + STEP_S * acceleration, 0.0)
        self.front_m = self.front_m + 0.5 * STEP_S * (self.speed_m_s + speed_m_s)
        self.speed_m_s = speed_m_s

    def room_m(self, line_m: float) -> Numbers:
        """(n,) way of each vehicle to a stop line; below 0 behind it, but on a loop to where it comes next."""
        return np.mod(line_m - self.front_m, self.loop_m) if math.isfinite(self.loop_m) else line_m - self.front_m

    def will_stop(self, line_m: float) -> Numbers:
        """(n,) whether each vehicle is before a stop line and can still stop there."""
        room_m = self.room_m(line_m)
        return np.asarray((room_m >= 0.0) & (self.speed_m_s**2 <= 2.0 * WILLING_M_S2 * np.maximum(room_m, 0.05)))

    def keeps_clear(self, line_m: float, end_m: float) -> bool:
        """Return whether no vehicle is between a stop line and the end of a crossing, or will be without stopping."""
        room_m, zone_m, will_stop = self.room_m(line_m), end_m - line_m + self.lengths_m, self.will_stop(line_m)
        if math.isfinite(self.loop_m):
            return bool(((self.loop_m - room_m > zone_m) & will_stop).all())
        return bool(((-room_m > zone_m) | ((room_m > 0.0) & will_stop)).all())


def driver_acceleration_m_s2(
    *, speed_m_s: Numbers, desired_m_s: Numbers, gap_m: Numbers, closing_m_s: Numbers
) -> Numbers:
    """Acceleration of drivers (T173) who wish for a speed and for a gap to the vehicle ahead (T174).

    Args:
        gap_m: from a vehicle's front to the rear of the one ahead
        closing_m_s: by how much it is faster
    """
    pace = HEADWAY_S * speed_m_s + speed_m_s * closing_m_s / (2.0 * np.sqrt(ACCELERATION_M_S2 * BRAKING_M_S2))
    wanted_m = STANDING_GAP_M + np.maximum(pace, 0.0)
    acceleration = ACCELERATION_M_S2 * (1.0 - (speed_m_s / desired_m_s) ** 4 - (wanted_m / np.maximum(gap_m, 0.1)) ** 2)
    return np.asarray(np.maximum(acceleration, -HARDEST_M_S2))


@dataclass(slots=True)
class _Closing:
    """A crossing that closes for the ego vehicle: when others go there, and when it opens.

    Attributes:
        lines_m: lane -> its stop line and the far edge
        go_s: times at which others went: once, or once in each lap of a loop
        is_due: whether it closes as the ego vehicle comes near
    """

    crossing: Crossing
    lines_m: Mapping[_Lane, Sequence[float]]
    duration_s: float
    clear_s: float = 0.0
    is_closed: bool = False
    is_due: bool = True
    go_s: list[float] = field(default_factory=list)

    def update(self, now_s: float, ego: _Lane, ego_index: int, lanes: Sequence[_Lane]) -> None:
        """Close as the ego vehicle comes near enough to wait, let the others go, and open."""
        room_m = float(ego.room_m(self.lines_m[ego][0])[ego_index])
        if not self.is_due:
            self.is_closed = now_s < self.go_s[-1] + self.duration_s + CLEAR_S
            # Again in the next lap, once the ego vehicle is well past it.
            self.is_due = not self.is_closed and math.isfinite(ego.loop_m) and room_m > 0.5 * ego.loop_m
            return
        if not self.is_closed:
            speed_m_s = float(ego.speed_m_s[ego_index])
            braking_m = speed_m_s**2 / (2.0 * BRAKING_M_S2)
            self.is_closed = bool(0.7 * braking_m + 2.0 < room_m < braking_m + 2.0 * speed_m_s + 6.0)
            return
        clear = all(lane.keeps_clear(*self.lines_m[lane]) for lane in lanes)
        self.clear_s = self.clear_s + STEP_S if clear else 0.0
        if self.clear_s >= CLEAR_S:
            self.go_s.append(now_s)
            self.is_due, self.clear_s = False, 0.0


def drive(layout: Layout) -> Traffic:
    """Let the traffic of a street go until the ego vehicle has come to its end; the same for the same file."""
    file = layout.file
    way_m = file.length_m * (file.laps if file.loop else 1)
    random = np.random.default_rng([file.seed, 2])
    lanes = _fill_lanes(layout, random)
    ego_lane, ego_index = lanes[0], file.ahead
    closings = _draw_closings(layout, lanes, random)
    (end_m,) = ego_lane.way_m(way_m)
    # Of lanes towards -x none is in sight.
    ends_m = [lane.way_m(layout.end_m - 10.0)[0] if lane.direction > 0 else 1e6 for lane in lanes]
    # All but the ego vehicle go on to the road's end, the oncoming ones beyond all that is shown.
    steps, rested = 0, 0
    while rested < 20 and steps * STEP_S < 20.0 + way_m:
        for lane in lanes:
            lane.history.append(lane.front_m)
        now_s = steps * STEP_S
        for closing in closings:
            closing.update(now_s, ego_lane, ego_index, lanes)
        for lane, last_m in zip(lanes, ends_m, strict=True):
            lane.step([closing.lines_m[lane][0] for closing in closings if closing.is_closed], last_m)
        _stop_at_end(ego_lane, ego_index, end_m)
        steps += 1
        arrived = ego_lane.front_m[ego_index] > end_m - 5.0 and ego_lane.speed_m_s[ego_index] < 0.05
        rested = rested + 1 if arrived else 0
    for lane in lanes:
        lane.history.append(lane.front_m)
    time_s = STEP_S * np.arange(steps + 1)
    tracks = [track for lane in lanes for track in _vehicle_tracks(lane, time_s)]
    ego_x_m = tracks.pop(ego_index).x_m  # of the first lane
    if file.loop:  # to where it began, to the last millimetre
        ego_x_m = ego_x_m * (way_m / ego_x_m[-1])
    for closing in closings:
        tracks += _crossing_tracks(layout, closing, time_s, random)
    tracks += _walking_tracks(layout, time_s, random)
    ego = _track("own_car", time_s, ego_x_m, layout.lane_m(0, 1), 0.0)
    others = [_shown(layout, track, ego_x_m) for track in tracks]
    return Traffic(ego.between(0, steps), [track for track in others if track is not None])


def _stop_at_end(lane: _Lane, index: int, end_m: float) -> None:
    """Hold the ego vehicle's speed to what lets it stop where its way ends, at its usual braking."""
    room_m = max(end_m + 0.5 * CAR_M[0] - float(lane.front_m[index]), 0.0)
    most_m_s = np.sqrt(2.0 * BRAKING_M_S2 * room_m) if room_m > 0.02 else 0.0
    lane.speed_m_s[index] = min(float(lane.speed_m_s[index]), most_m_s)


def _fill_lanes(layout: Layout, random: np.random.Generator) -> list[_Lane]:
    """Place the vehicles of all lanes at time 0; the ego vehicle's lane is the first."""
    file, line = layout.file, layout.line
    lanes = []
    for direction in (1, -1):
        for lane in range(file.lanes):
            is_own = direction > 0 and lane == 0
            if is_own:
                gaps_m = np.append(0.0, random.uniform(18.0, 40.0, file.ahead + file.behind))
            else:
                # Those that the ego vehicle meets later come from beyond the end of its way.
                reach_m = 2.0 * file.shown_m if direction > 0 else 5.0 * file.length_m + 4.0 * file.shown_m
                reach_m = file.length_m if file.loop else reach_m
                gaps_m = random.uniform(*file.oncoming_gap_m, int(reach_m / np.mean(file.oncoming_gap_m)) + 1)
            y_m, without = layout.lane_m(lane, direction), ("cyclist",) if is_own else ()
            loop_m = float(np.ptp(line.way_beside_m(line.node_m[[0, -1]], y_m))) if file.loop else math.inf
            names = [_draw(layout, random, y_m, without=without) for _ in gaps_m]
            if is_own:
                names[file.ahead] = "own_car"
            lengths_m = np.array([CAR_M[0] if name == "own_car" else vehicle_length_m(name) for name in names])
            gaps_m[1:] = np.maximum(gaps_m[1:], 0.5 * (lengths_m[1:] + lengths_m[:-1]) + 8.0)
            middle_m = -np.cumsum(gaps_m)
            middle_m += file.shown_m if not is_own else -middle_m[file.ahead]
            if file.loop and not is_own:
                fits = middle_m > middle_m[0] - loop_m + 0.5 * (lengths_m[0] + lengths_m) + 8.0
                middle_m, lengths_m = middle_m[fits], lengths_m[fits]
                names = [name for name, stays in zip(names, fits, strict=True) if stays]
            desired_m_s = random.uniform(*file.speed_m_s, len(names))
            desired_m_s[["cyclist" in name for name in names]] *= CYCLIST_SHARE
            # The vehicle rests where a loop begins and ends.
            speed_m_s = (0.0 if file.loop and is_own else 0.6) * desired_m_s
            front_m = middle_m + 0.5 * lengths_m
            gaps_m = front_m[:-1] - lengths_m[:-1] - front_m[1:] - STANDING_GAP_M
            for number, gap_m in enumerate(gaps_m.tolist(), start=1):  # nobody begins too fast to brake behind another
                speed_m_s[number] = min(
                    speed_m_s[number], math.sqrt(speed_m_s[number - 1] ** 2 + 2.0 * WILLING_M_S2 * gap_m)
                )
            vehicles = front_m, speed_m_s, desired_m_s, lengths_m, names
            places_m, limits_m_s = line.speed_limit_m_s(direction, y_m)
            limit_m_s = direction * line.way_beside_m(direction * places_m, y_m), limits_m_s
            lanes.append(_Lane(line, y_m, direction, *vehicles, loop_m, limit_m_s))
    return lanes


def _draw(
    layout: Layout,
    random: np.random.Generator,
    y_m: float = 0.0,
    *,
    longest_m: float = math.inf,
    without: tuple[str, ...] = (),
) -> str:
    """Name of the body of a vehicle that keeps to its lane at y, bends included."""
    return draw_vehicle(
        "traffic",
        *random.random(2),
        longest_m=longest_m,
        widest_m=layout.file.lane_width_m - LANE_ROOM_M,
        curvature_per_m=layout.line.sharpest_per_m(layout.begin_m, layout.end_m, y_m),
        without=without,
    )


def _draw_closings(layout: Layout, lanes: Sequence[_Lane], random: np.random.Generator) -> list[_Closing]:
    """Draw the crossings at which the ego vehicle has to wait."""
    closings = []
    for crossing in layout.crossings:
        if layout.file.loop and not crossing.is_zebra:
            continue  # who has crossed is not there to cross again in the next lap
        if random.random() < layout.file.stop_share and 30.0 < crossing.x_m < layout.file.length_m - 20.0:
            way_m = 2.0 * layout.kerb_m + 2.0
            duration_s = way_m / WALK_M_S[0] if crossing.is_zebra else _crossing_times(layout)[1]
            closings.append(_Closing(crossing, {lane: lane.lines_m(crossing) for lane in lanes}, duration_s))
    return closings


def _crossing_times(layout: Layout) -> tuple[float, float]:
    """Distance of a waiting vehicle's middle from that of the street [m]; time until its rear is off the road [s]."""
    start_m = layout.kerb_m + QUEUE_M + 0.5 * CAR_M[0]
    way_m = start_m + layout.kerb_m + 0.5 * CAR_M[0]
    return start_m, float(np.sqrt(2.0 * way_m / ACCELERATION_M_S2)) + 0.5


def _shown(layout: Layout, track: Track, ego_x_m: Numbers) -> Track | None:
    """Return the track while it is near the ego vehicle; None if it never is. Nothing hides on a loop."""
    is_near = layout.file.loop | (np.abs(track.x_m - ego_x_m) <= layout.file.shown_m)
    rows = np.flatnonzero(is_near)
    return track.between(rows[0], rows[-1]) if len(rows) > 1 else None


def _vehicle_tracks(lane: _Lane, time_s: Numbers) -> Iterator[Track]:
    """Yield the tracks of the vehicles of a lane."""
    middle_m = lane.direction * (np.array(lane.history) - 0.5 * lane.lengths_m)
    places_m = lane.line.way_from_beside_m(middle_m.ravel(), lane.y_m).reshape(middle_m.shape)
    for name, x_m in zip(lane.names, places_m.T, strict=True):
        yield _track(name, time_s, x_m, lane.y_m, 90.0 - 90.0 * lane.direction)


def _crossing_tracks(
    layout: Layout, closing: _Closing, time_s: Numbers, random: np.random.Generator
) -> Iterator[Track]:
    """Yield the tracks of the vehicles or people who cross while a crossing is closed."""
    crossing = closing.crossing
    # Without a start, if the ego vehicle never came so far, they wait.
    since_s = np.maximum(time_s - np.array(closing.go_s or [np.inf])[:, None], 0.0)
    if crossing.is_zebra:
        # Who comes across a street has room for a step, on a narrow pavement, too.
        people, half_m = int(random.integers(1, 4)), layout.kerb_m + min(1.0, layout.file.pavement_m - 2.2)
        for number in range(people):
            side, speed_m_s = random.choice([-1.0, 1.0]), random.uniform(*WALK_M_S)
            # They come back when it closes again, and turn round for that once they are across.
            walked_m = np.minimum(speed_m_s * since_s, 2.0 * half_m).sum(axis=0)
            turned = np.clip((since_s - 2.0 * half_m / speed_m_s) / TURN_S, 0.0, 1.0).sum(axis=0)
            y_m = side * (np.abs(np.mod(walked_m, 4.0 * half_m) - 2.0 * half_m) - half_m)
            x_m = crossing.x_m + 1.2 * (number - 0.5 * (people - 1))
            yield _track("walkers", time_s, x_m, y_m, -90.0 * side + 180.0 * turned * layout.file.loop)
        return
    start_m, _ = _crossing_times(layout)
    directions = [(-1.0,), (1.0,), (-1.0, 1.0)][random.integers(3)]
    for direction in directions:
        # Speeds up, drives on evenly, and brakes to stand at the end of the street that crosses.
        y_m = direction * (_stop_and_go_m(since_s[0], start_m + 50.0) - start_m)
        name, x_m = _draw(layout, random, longest_m=CAR_M[0]), crossing.x_m + direction * 0.5 * CROSS_LANE_M
        yield _track(name, time_s, x_m, y_m, 90.0 * direction)


def _stop_and_go_m(since_s: Numbers, way_m: float) -> Numbers:
    """Way of a vehicle from rest to rest that speeds up to `CROSS_M_S` and brakes."""
    rise_s, fall_s = CROSS_M_S / ACCELERATION_M_S2, CROSS_M_S / BRAKING_M_S2
    even_s = (way_m - 0.5 * CROSS_M_S * (rise_s + fall_s)) / CROSS_M_S
    node_s = np.cumsum([0.0, rise_s, even_s, fall_s])
    return integral(np.minimum(since_s, node_s[-1]), node_s, np.array([0.0, CROSS_M_S, CROSS_M_S, 0.0]))


def _walking_tracks(layout: Layout, time_s: Numbers, random: np.random.Generator) -> Iterator[Track]:
    """Yield tracks of people who walk round and round on the pavements of each block, all at one pace there."""
    for block in layout.blocks:
        inside = 1.0 - layout.line.sharpest_per_m(block.begin_m, block.end_m) * layout.front_m
        between_m = max(BETWEEN_M, INSIDE_M / max(inside, LEAST_SHARE))
        for side in (-1, 1):
            speed_m_s = random.uniform(*WALK_M_S)
            straight_m = block.length_m - 4.0
            way_m, at_s = _round_times(straight_m, 0.5 * (layout.walk_m(1) - layout.walk_m(-1)), speed_m_s)
            spacing_m = random.uniform(*layout.file.walking_spacing_m, int(way_m[-1] / 5.0))
            places_m = np.cumsum(np.maximum(spacing_m, between_m))
            for begin_s in np.interp(places_m[places_m < way_m[-1] - between_m], way_m, at_s):
                walked_m = np.interp(np.mod(begin_s + time_s, at_s[-1]), at_s, way_m)
                x_m, y_m, yaw_deg = _round_walk(layout, walked_m, straight_m)
                yield _track("walkers", time_s, block.begin_m + 2.0 + x_m, side * y_m, side * yaw_deg)


def _round_times(straight_m: float, radius_m: float, speed_m_s: float) -> tuple[Numbers, Numbers]:
    """Places on a way there and back with half circles between, and when people are there, who are slower in these."""
    half_m = straight_m + np.pi * radius_m
    way_m = np.linspace(0.0, 2.0 * half_m, 1 + 2 * math.ceil(half_m / WALK_STEP_M))
    along_m = np.mod(way_m, half_m)
    room_m = np.maximum(np.minimum(along_m, straight_m - along_m), 0.0)
    slowest_m_s = speed_m_s / math.hypot(1.0, CIRCLE_M / radius_m)
    pace_m_s = np.minimum(np.sqrt(slowest_m_s**2 + 2.0 * SLOWING_M_S2 * room_m), speed_m_s)
    return way_m, integral(way_m, way_m, 1.0 / pace_m_s)


def _round_walk(layout: Layout, way_m: Numbers, straight_m: float) -> tuple[Numbers, Numbers, Numbers]:
    """x, y [m] and yaw [degrees] on a way there, a half circle, the way back, and another half circle."""
    middle_m, radius_m = (0.5 * (layout.walk_m(1) + sign * layout.walk_m(-1)) for sign in (1.0, -1.0))
    there_m, half_m = np.minimum(way_m, straight_m), straight_m + np.pi * radius_m
    back_m = np.clip(way_m - half_m, 0.0, straight_m)
    angle = np.clip((way_m - straight_m) / radius_m, 0.0, np.pi)
    angle += np.clip((way_m - half_m - straight_m) / radius_m, 0.0, np.pi)
    x_m = there_m - back_m + radius_m * np.sin(angle)
    return x_m, middle_m + radius_m * np.cos(angle), -np.degrees(angle)
