"""Catalogues and their runs, searches of a requirement, and what estimators have learned."""

import json
from pathlib import Path

import damage
from attack.attempts import BITS
from attack.material import SEARCH, material
from attack.mutation import mutate_tree, pick
from attack.texts import as_text, as_tree, reduce_sizes, scenarios


def strike(random):
    """Damage one of them, and return the words of the command that reads it."""
    what = random.integers(4)
    if what == 0:
        tree = mutate_tree(as_tree(Path("catalogue.yaml").read_text()), random, [scenarios()["cartpole"]])
        Path("catalogue.yaml").write_bytes(as_text(reduce_sizes(tree)))
        return ["rate", "catalogue.yaml", "--quiet", "--out", "o", "--budget", "rollouts=150"]
    if what == 1:
        path = pick(random, sorted(file for file in Path("search").rglob("*.*") if file.is_file()))
        path.write_bytes(_damaged(path, random))
        return SEARCH
    if what == 2:
        path = pick(
            random, sorted(path for path in Path("rates").rglob("*.*") if path.suffix in (".json", ".npz"))
        )
        path.write_bytes(_damaged(path, random))
        return ["rate", "catalogue.yaml", "--quiet", "--out", "rates", "--resume"]
    name = pick(random, ["is", "smc"])
    path = Path(f"learned_{name}.json")
    path.write_bytes(damage.damage_json(path.read_bytes(), random))
    words = ["--learned", str(path), "--estimator", name, "--out", "o", "--no-pictures"]
    size = ["estimator.rollouts=30"] if name == "is" else ["estimator.particles=20", "estimator.runs=2"]
    return ["run", "walk.yaml", *words, *(f"--set={one}" for one in size)]


def _damaged(path, random):
    if path.suffix == ".npz":
        return damage.damage_arrays(path.read_bytes(), random)
    on_purpose = random.random() < 0.5  # then it may give another answer
    if on_purpose:
        Path("sealed").touch()
    return damage.damage_json(path.read_bytes(), random, on_purpose)


def same_answer(outcome):
    """Tell when a damaged search or catalogue's run was resumed to another answer."""
    home, place = Path("..").resolve(), Path("rates/rate.json")
    if (
        Path("sealed").exists()
        or outcome.code not in (0, 3)
        or outcome.words[0] not in ("rate", "require")
        or "o" in outcome.words
    ):
        return None
    place = place if outcome.words[0] == "rate" else Path("search/require.json")
    before = json.loads((material(home, place.parts[0]) / place.name).read_text())
    return BITS if json.loads(place.read_text()) != before else None
