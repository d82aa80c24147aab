"""Runs cases again, or new ones.

    PYTHONPATH=tests python -m fuzz FILE...           cases that were kept: what they break, and what was said
    PYTHONPATH=tests python -m fuzz GROUP|all [N]     the cases of a group for the number N (0)
"""

import os
import sys
import tempfile
from pathlib import Path

from fuzz.campaign import Campaign
from fuzz.case import Case
from fuzz.groups import GROUPS


def main() -> int:
    """Give 1 where a case fails."""
    words = sys.argv[1:] or ["all"]
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        campaign = Campaign(Path(folder), len(os.sched_getaffinity(0)), Path("out/fuzz"))
        campaign.make_good()
        try:
            if words[0] in (*GROUPS, "all"):
                return _groups(campaign, list(GROUPS) if words[0] == "all" else [words[0]],
                               int(words[1]) if words[1:] else 0)
            return _files(campaign, words)
        finally:
            campaign.close()


def _groups(campaign: Campaign, names: list[str], number: int) -> int:
    failed = 0
    for name in names:
        tally = campaign.run_all(campaign.group(name, number))
        print(f"{name}: {tally}", flush=True)
        failed += len(tally.failed)
    return int(failed > 0)


def _files(campaign: Campaign, names: list[str]) -> int:
    failed = 0
    for name in names:
        case = Case.read(Path(name))
        result = campaign.run(case)
        print(f"{name}: mitsvbrdf "
              f"{' '.join(case.arguments)}\n{result.said}\n{result.answer}\n{result.wrong or 'holds'}\n")
        failed += bool(result.wrong)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
