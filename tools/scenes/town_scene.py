"""The town scene: a loop of streets that is made from a seed when it is loaded, for drives without end."""

from scenefile import table, value

LENGTH_M = 900.0


def text():
    """The scene file: all but the street's own keys is as `[street]` has it."""
    first = "# Made by tools/scenes/make_scenes.py; change it there and run it again.\n"
    description = (
        "round and round a loop of streets that is made from a seed, with bends, traffic, crossings and people"
    )
    first += table(f"name = {value('town')}", description=description)
    return "\n".join([first, table("[street]", seed=1, length_m=LENGTH_M, loop=True)])
