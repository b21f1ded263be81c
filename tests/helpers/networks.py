"""Small road networks of our own: an OpenDRIVE road that bends, two streets of OpenStreetMap, a town of SUMO."""

import math
import subprocess
from pathlib import Path

STRAIGHT_M, SPIRAL_M, ARC_M, RADIUS_M = 60.0, 40.0, 50.0, 60.0

_LANES = """
      <laneSection s="0">
        <left>
          <lane id="1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
        </left>
        <center><lane id="0" type="none"/></center>
        <right>
          <lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
          <lane id="-2" type="sidewalk"><width sOffset="0" a="2.0" b="0" c="0" d="0"/></lane>
        </right>
      </laneSection>"""


def opendrive(end_of_spiral: tuple[float, float, float]) -> str:
    """A road along x that bends to the left, and its spiral's end."""
    x, y, heading = end_of_spiral
    begin = STRAIGHT_M + SPIRAL_M
    return f"""<?xml version="1.0"?>
<OpenDRIVE>
  <header revMajor="1" revMinor="4" name="bend"/>
  <road name="bend" length="{begin + ARC_M}" id="1" junction="-1">
    <planView>
      <geometry s="0" x="0" y="0" hdg="0" length="{STRAIGHT_M}"><line/></geometry>
      <geometry s="{STRAIGHT_M}" x="{STRAIGHT_M}" y="0" hdg="0" length="{SPIRAL_M}">
        <spiral curvStart="0" curvEnd="{1 / RADIUS_M}"/>
      </geometry>
      <geometry s="{begin}" x="{x}" y="{y}" hdg="{heading}" length="{ARC_M}">
        <arc curvature="{1 / RADIUS_M}"/>
      </geometry>
    </planView>
    <lanes>{_LANES}
    </lanes>
  </road>
</OpenDRIVE>
"""


RING = f"""<?xml version="1.0"?>
<OpenDRIVE>
  <header revMajor="1" revMinor="4" name="ring"/>
  <road name="ring" length="{2 * math.pi * RADIUS_M}" id="1" junction="-1">
    <link>
      <predecessor elementType="road" elementId="1" contactPoint="end"/>
      <successor elementType="road" elementId="1" contactPoint="start"/>
    </link>
    <planView>
      <geometry s="0" x="0" y="0" hdg="0" length="{2 * math.pi * RADIUS_M}"><arc curvature="{1 / RADIUS_M}"/></geometry>
    </planView>
    <lanes>{_LANES}
    </lanes>
  </road>
  <junction id="2" name="unfinished">
    <connection id="0" incomingRoad="1"/>
  </junction>
</OpenDRIVE>
"""
"""A road that ends where it begins, and a connection that leads nowhere."""

OSM = """<?xml version="1.0"?>
<osm version="0.6">
  <node id="1" lat="48.0000" lon="11.0000" version="1"/>
  <node id="2" lat="48.0000" lon="11.0020" version="1"/>
  <node id="3" lat="48.0003" lon="11.0040" version="1"/>
  <node id="4" lat="47.9990" lon="11.0020" version="1"/>
  <node id="5" lat="48.0010" lon="11.0020" version="1"/>
  <way id="10" version="1"><nd ref="1"/><nd ref="2"/><nd ref="3"/><tag k="highway" v="residential"/></way>
  <way id="11" version="1"><nd ref="4"/><nd ref="2"/><nd ref="5"/><tag k="highway" v="residential"/></way>
</osm>
"""

ROUTES = """<routes>
  <vType id="long_bus" vClass="bus" length="14.9"/>
  <trip id="first" depart="0" from="A0B0" to="B1A1" departPos="base"/>
  <trip id="rider" type="DEFAULT_BIKETYPE" depart="0" from="B0A0" to="A0A1" departPos="base"/>
  <trip id="line_7" type="long_bus" depart="1" from="B1A1" to="A1A0" departPos="40"/>
  <person id="walks" depart="1"><walk from="A0B0" to="A0B0" arrivalPos="60"/></person>
</routes>
"""


def scenario(folder: Path, name: str, nodes: str, edges: str, routes: str, *options: str, more: str = "") -> Path:
    """Write a network of these nodes and edges, by netconvert, with routes; return the configuration.

    Args:
        options: of netconvert
        more: tables of the configuration
    """
    import sumo

    for suffix, text in (("nod", f"<nodes>{nodes}</nodes>"), ("edg", f"<edges>{edges}</edges>"), ("rou", routes)):
        (folder / f"{name}.{suffix}.xml").write_text(text)
    program = str(Path(sumo.SUMO_HOME) / "bin" / "netconvert")
    files = ["-n", f"{name}.nod.xml", "-e", f"{name}.edg.xml", "-o", f"{name}.net.xml"]
    subprocess.run([program, *files, *options], check=True, capture_output=True, cwd=folder)
    path = folder / f"{name}.sumocfg"
    files_of = f'<net-file value="{name}.net.xml"/><route-files value="{name}.rou.xml"/>'
    path.write_text(f"<configuration><input>{files_of}</input>{more}</configuration>")
    return path


def bridge(folder: Path) -> Path:
    """Write a road to the east and one to the north 6 m above it, with one car each; return the configuration."""
    ends = [("w", -200, 0), ("e", 200, 0), ("s", 0, -200), ("n", 0, 200)]
    nodes = "".join(f'<node id="{name}" x="{x}" y="{y}" z="0"/>' for name, x, y in ends)
    hump = [(0, -200, 0), (0, -150, 0), (0, -100, 2), (0, -50, 5), (0, -20, 6)]
    hump += [(0, -y, z) for _, y, z in hump[::-1]]
    shape = " ".join(f"{x},{y},{z}" for x, y, z in hump)
    edges = '<edge id="we" from="w" to="e" numLanes="1" speed="14"/>'
    edges += f'<edge id="sn" from="s" to="n" numLanes="1" speed="14" shape="{shape}"/>'
    trips = "".join(f'<trip id="{name}" depart="0" from="{name}" to="{name}" departPos="60"/>' for name in ("we", "sn"))
    return scenario(folder, "bridge", nodes, edges, f"<routes>{trips}</routes>")


def wide_crossing(folder: Path, *, keeps_left: bool) -> Path:
    """Write roads of lanes 4.5 and 3 m wide, 3 m of island between the directions, which meet at lights, and a ring;
    return the configuration. Where traffic keeps to the left all is mirrored, y for -y.
    """
    side = -1 if keeps_left else 1
    ends = {"w": (-150, 0), "m": (0, 0), "e": (150, 40), "n": (10, 150)}
    ring = {f"r{k}": (300 + 20 * math.cos(k * math.pi / 2), 40 + 20 * math.sin(k * math.pi / 2)) for k in range(4)}
    nodes = "".join(
        f'<node id="{name}" x="{x}" y="{side * y}" type="{"traffic_light" if name == "m" else "priority"}"/>'
        for name, (x, y) in (ends | ring).items()
    )
    lanes = '<lane index="0" width="4.5"/><lane index="1" width="3"/>'
    edges = ""
    for begin, end in (("w", "m"), ("m", "e"), ("n", "m")):
        for a, b in ((begin, end), (end, begin)):
            (ax, ay), (bx, by) = ends[a], ends[b]
            length_m = math.hypot(bx - ax, by - ay)
            right = 1.5 * (by - ay) / length_m, -1.5 * (bx - ax) / length_m
            shape = " ".join(f"{x + right[0]:.3f},{side * (y + right[1]):.3f}" for x, y in ((ax, ay), (bx, by)))
            keys = f'id="{a}{b}" from="{a}" to="{b}" numLanes="2" speed="14" shape="{shape}"'
            edges += f"<edge {keys}>{lanes}</edge>"
    pairs = [*((f"r{k}", f"r{(k + 1) % 4}") for k in range(4)), ("e", "r2"), ("r2", "e")]
    edges += "".join(f'<edge id="{a}{b}" from="{a}" to="{b}" numLanes="1" speed="8"/>' for a, b in pairs)
    edges += '<roundabout nodes="r0 r1 r2 r3" edges="r0r1 r1r2 r2r3 r3r0"/>'
    options = ["--offset.disable-normalization", *(["--lefthand"] if keeps_left else [])]
    routes = '<routes><trip id="first" depart="0" from="wm" to="me"/></routes>'
    return scenario(folder, "a", nodes, edges, routes, *options)


def sumo_town(folder: Path, heights_m: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)) -> Path:
    """Write a block of four streets with pavements, crossings and lights, and traffic; return the configuration.

    Args:
        heights_m: of the junctions A0, B0, A1 and B1
    """
    corners = [("A0", 0, 0), ("B0", 100, 0), ("A1", 0, 100), ("B1", 100, 100)]
    nodes = "".join(
        f'<node id="{name}" x="{x}" y="{y}" z="{z}" type="traffic_light"/>'
        for (name, x, y), z in zip(corners, heights_m, strict=True)
    )
    streets = [("A0", "B0"), ("A0", "A1"), ("B0", "B1"), ("A1", "B1")]
    ways = [(a, b) for pair in streets for a, b in (pair, pair[::-1])]
    edges = "".join(f'<edge id="{a}{b}" from="{a}" to="{b}" numLanes="1" speed="13.89"/>' for a, b in ways)
    walks = "--sidewalks.guess", "--crossings.guess"
    return scenario(folder, "town", nodes, edges, ROUTES, *walks, more='<time><end value="120"/></time>')
