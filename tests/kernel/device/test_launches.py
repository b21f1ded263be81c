"""Kernels of a frame: a GPU waits for each launch, and prepares each that asks OptiX for a second, in every process."""

from helpers import launches

from lidarscene.rendering.simulator import Simulator


def test_a_frame_among_moving_bodies_is_a_few_kernels(mi) -> None:
    """Three frames at once are as many kernels as one: pulses of all of them share each launch."""
    sim = Simulator("drive", "vlp-16")
    sim.render(number=0)
    with launches.launched() as kernels:
        sim.render(number=1)
    assert 0 < len(kernels) < 20
    assert sum(bool(kernel.get("uses_optix")) for kernel in kernels) <= 3
