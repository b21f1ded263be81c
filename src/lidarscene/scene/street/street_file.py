"""[street]: a street that is made from a seed, as a table of a scene file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from ...files.toml import FileModel

Share = Annotated[float, Field(ge=0, le=1)]
Spacing = Annotated[float, Field(ge=5, le=1e4)]
Block = Annotated[float, Field(ge=40, le=1e4)]
Angle = Annotated[float, Field(ge=0, le=60)]
Radius = Annotated[float, Field(ge=20, le=1e4)]
Setback = Annotated[float, Field(ge=0, le=30)]
Speed = Annotated[float, Field(ge=1, le=40)]
Slope = Annotated[float, Field(ge=0, le=15)]


def _rising(low_and_high: tuple[float, float]) -> tuple[float, float]:
    if low_and_high[0] > low_and_high[1]:
        raise ValueError(f"must be a lowest and a highest value, got {low_and_high[0]:g} and {low_and_high[1]:g}")
    return low_and_high


Shares = Annotated[tuple[Share, Share], AfterValidator(_rising)]
Spacings = Annotated[tuple[Spacing, Spacing], AfterValidator(_rising)]
Blocks = Annotated[tuple[Block, Block], AfterValidator(_rising)]
Angles = Annotated[tuple[Angle, Angle], AfterValidator(_rising)]
Radii = Annotated[tuple[Radius, Radius], AfterValidator(_rising)]
Setbacks = Annotated[tuple[Setback, Setback], AfterValidator(_rising)]
Speeds = Annotated[tuple[Speed, Speed], AfterValidator(_rising)]
Slopes = Annotated[tuple[Slope, Slope], AfterValidator(_rising)]


class StreetFile(FileModel):
    """[street]: a street with bends and crossings, and traffic on it. Of two numbers each thing draws one between them.

    The vehicle that carries the sensor drives on the right, from the origin, where the street goes along x, for
    ``length_m``; or round a loop of that length.
    """

    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = Field(default=1, description="of all random choices")
    length_m: Annotated[float, Field(ge=50, le=2e4)] = Field(default=1000.0, description="way of the ego vehicle")
    loop: bool = Field(default=False, description="a loop, on which the ego vehicle drives for ever")
    laps: Annotated[int, Field(ge=1, le=100)] = Field(
        default=2, description="of a loop, after which the vehicle rests and all traffic begins again"
    )
    corners: Literal["bends", "junctions"] = Field(
        default="bends", description="of a loop; at junctions the vehicle turns left or right, and other streets go on"
    )
    bend_spacing_m: Spacings = Field(default=(40.0, 160.0), description="straight between bends; a loop has six bends")
    bend_deg: Angles = Field(default=(10.0, 60.0), description="by which a bend turns; those of a loop turn by 90")
    bend_radius_m: Radii = Field(
        default=(25.0, 120.0), description="of the middle of a bend; less on a short loop, more on a wide street"
    )
    slope_percent: Slopes = Field(
        default=(0.0, 0.0), description="steepest slope of a hill, up or down; streets are level where others cross"
    )
    wet: bool = Field(default=False, description="roads and pavements under a film of water")
    lanes: Annotated[int, Field(ge=1, le=3)] = Field(default=1, description="in each direction")
    lane_width_m: Annotated[float, Field(ge=2.6, le=5)] = Field(default=3.2, description="of each lane")
    pavement_m: Annotated[float, Field(ge=2.8, le=10)] = Field(default=3.2, description="width of the pavements")
    block_m: Blocks = Field(default=(90.0, 180.0), description="from crossing to crossing")
    zebra_share: Share = Field(default=0.6, description="of blocks with a zebra crossing")
    house_share: Shares = Field(default=(0.7, 1.0), description="of plots with a house, on each side of a block")
    setback_m: Setbacks = Field(default=(0.0, 2.0), description="from the pavement to a house")
    parked_share: Shares = Field(default=(0.1, 0.5), description="of bays with a car, on each side of a block")
    tree_spacing_m: Spacings = Field(default=(12.0, 30.0), description="from tree to tree")
    lamp_spacing_m: Spacings = Field(default=(25.0, 35.0), description="from lamp post to lamp post")
    sign_spacing_m: Spacings = Field(default=(40.0, 120.0), description="from sign to sign")
    standing_spacing_m: Spacings = Field(default=(25.0, 90.0), description="between people who stand")
    walking_spacing_m: Spacings = Field(default=(60.0, 160.0), description="between people who walk")
    speed_m_s: Speeds = Field(default=(9.0, 13.0), description="that a driver wants")
    oncoming_gap_m: Spacings = Field(default=(40.0, 140.0), description="between vehicles on other lanes at the start")
    ahead: Annotated[int, Field(ge=0, le=5)] = Field(default=1, description="vehicles ahead on the own lane")
    behind: Annotated[int, Field(ge=0, le=5)] = Field(default=1, description="vehicles behind on the own lane")
    stop_share: Share = Field(
        default=0.4, description="of crossings at which the vehicle has to wait for people or cars that cross"
    )
    shown_m: Annotated[float, Field(ge=50, le=1000)] = Field(
        default=180.0, description="distance to the ego vehicle beyond which what moves is hidden"
    )
