"""``python -m attack``: the long attack, which goes on where it stopped."""

import argparse
import sys
from pathlib import Path

_EPILOG = """The folder holds progress.json (counts, and the seed of whatever was found) and table.md.
To see one input again: python -m attack --only formulas --seed 17; it stays in FOLDER/work."""


def main() -> int:
    """Attack, print the table, and return 1 if anything was found."""
    parser = argparse.ArgumentParser(prog="python -m attack", description=__doc__, epilog=_EPILOG)
    parser.add_argument("--folder", default="runs/attack", type=Path, help="default: runs/attack")
    parser.add_argument("--inputs", type=int, default=10_000, help="inputs of each kind (10000)")
    parser.add_argument("--kills", type=int, default=1_000, help="kills (1000)")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so long")
    parser.add_argument("--only", action="append", default=[], help="a kind, `kills` or `crash points`")
    parser.add_argument(
        "--seed", type=int, help="try this input of the kind in --only, and say what happened"
    )
    args = parser.parse_args()
    folder = args.folder.resolve()
    if args.seed is not None:
        return _one(folder, args.only[0], args.seed)
    from attack.long_run import run

    progress = run(folder, args.inputs, args.kills, args.only, args.seconds)
    print(progress.table())
    return int(bool(progress.content["found"]))


def _one(folder, name, seed) -> int:
    from attack import kills, material
    from attack.kinds import attempt

    folder.mkdir(parents=True, exist_ok=True)
    with material.inside(folder):
        if name == "kills":
            (folder / "kills").mkdir(exist_ok=True)
            found, told, _ = kills.harass(seed, folder / "kills")
        else:
            found, told = attempt(name, seed, folder)
    print(found or "nothing is wrong", told, sep="\n")
    return int(found is not None)


if __name__ == "__main__":
    sys.exit(main())
