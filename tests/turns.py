"""Which of the long tests begin first on a day that has no time for all of them."""

DAILY = 3  # documented commands that a day begins with
GOLDEN = (5**0.5 - 1) / 2


def in_turn(items, day):
    """Items in the order of a day: a few documented commands, then the other tests from another place every day.

    Commands follow one another from day to day, so that all have had their turn after a `DAILY`-th of their number.
    Steps of the golden ratio leave no gap between the places where days begin that is much wider than others, whatever
    the number of tests is.

    Parameters
    ----------
    items : list of pytest.Item
    day : int
        Of any calendar that counts days.
    """
    commands = [item for item in items if item.get_closest_marker("command")]
    others = [item for item in items if not item.get_closest_marker("command")]
    count = min(DAILY, len(commands))
    start = day * DAILY % max(1, len(commands))
    commands = commands[start:] + commands[:start]
    first = int(day * GOLDEN % 1 * len(others))
    return commands[:count] + others[first:] + others[:first] + commands[count:]
