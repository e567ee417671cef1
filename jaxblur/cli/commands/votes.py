"""``jaxblur votes``: analyze the files that the page of ``jaxblur study`` saves."""

import argparse
import json
import logging
from typing import Any

from ..arguments import CommandError, add_command, file_path
from ..console import print_line, print_table

LOG = logging.getLogger("jaxblur")


def add_parser(commands: Any) -> None:
    """Add the command."""
    parser = add_command(
        commands, "votes", "Say which pictures of a study people tell apart, and prefer.", run
    )
    parser.add_argument(
        "input", type=file_path, nargs="+", metavar="VOTES.csv", help="one file for each observer"
    )
    parser.add_argument(
        "--alpha",
        type=float,
        default=0.01,
        metavar="P",
        help="significance of the groups (default %(default)s)",
    )
    parser.add_argument(
        "--least-right",
        type=float,
        default=0.8,
        metavar="SHARE",
        help="leave out observers with fewer right answers to catch trials (default %(default)s)",
    )
    parser.add_argument("--group", metavar="NAME", help="count the observers of one group only")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the analysis; see `add_parser`."""
    from jaxblur import perception

    votes = perception.read_votes(arguments.input, arguments.least_right)
    for observer, share in votes.left_out.items():
        LOG.warning(
            "%s answered %.0f %% of the catch trials right, and is left out.", observer, 100 * share
        )
    for observer, count in votes.unfinished.items():
        LOG.warning(
            "%s: %d votes are not counted, for they are of rounds that lack pairs.", observer, count
        )
    if arguments.group is not None and len(votes.counts):
        votes = votes.of_group(arguments.group)
    if len(votes.counts) < 3:
        raise CommandError(
            f"{', '.join(map(str, arguments.input))}: {len(votes.counts)} complete rounds of all "
            "pairs; the analysis needs three or more."
        )
    found = perception.analyze(votes, arguments.alpha)
    if arguments.json:
        plain = found._asdict() | {
            "equality": found.equality._asdict(),
            "agreement_test": found.agreement_test._asdict(),
            "observers": sorted(set(votes.observers)),
            "left_out": dict(votes.left_out),
        }
        print(json.dumps(plain, indent=2))
        return 0
    belongs = {
        name: ", ".join(str(k) for k, group in enumerate(found.groups, start=1) if name in group)
        for name in found.scores
    }
    most = found.rounds * (len(found.scores) - 1)
    rows = [
        (name, str(score), f"{100 * score / most:.0f} %", belongs[name])
        for name, score in found.scores.items()
    ]
    print_table(("", ">votes", ">preferred", "group"), rows)
    observers = len(set(votes.observers))
    print_line(f"{found.rounds} rounds by {observers} observers")
    print_line(
        f"Within a group, votes differ by less than {found.least_difference}, which may be chance "
        f"(alpha {arguments.alpha:g})."
    )
    print_line(
        f"all equally good: chi-square {found.equality.statistic:.1f} with "
        f"{found.equality.degrees:g} degrees of freedom, p {found.equality.p:.2g}"
    )
    print_line(f"consistency of the rounds: {found.consistency:.3f} (1: no contradiction)")
    print_line(
        f"agreement between the rounds: {found.agreement:.3f} (1: all alike), by chance p "
        f"{found.agreement_test.p:.2g}"
    )
    return 0
