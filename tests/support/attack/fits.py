"""Tables of detections and samples, and trained policies: what the fits and conversions of plugins read."""

import functools
import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import damage
from attack.mutation import mutate_table, mutate_text, pick

FIT = ["pem", "fit", "detections.csv", "--model", "logistic", "--out", "fitted"]
FLOW = ["flow", "fit", "samples.npy", "--steps", "2", "--out", "fitted"]


@functools.cache
def shorten():
    """Let fits of a logistic model take a handful of steps: what is attacked are their files."""
    from avrare_pem_training import pipeline

    recipe, columns = pipeline.RECIPES["logistic"]
    short = replace(recipe, members=1, epochs=1, least_steps=2, least_gain=np.inf)
    pipeline.RECIPES["logistic"] = short, columns


def strike(random):
    """Damage one of the files, and return the words of the command that reads it."""
    shorten()
    return pick(random, [_detections, _texts, _model, _samples, _policy])(random)


def _table(path, random):
    content = mutate_table(path.read_text(), random).encode("utf-8", "surrogatepass")
    path.write_bytes(damage.damage_bytes(content, random) if random.random() < 0.2 else content)


def _detections(random):
    _table(Path("detections.csv"), random)
    return FIT if random.random() < 0.2 else ["pem", "score", "pem.npz", "detections.csv"]


def _texts(random):
    path = Path(pick(random, ["vehicles.txt", "labels.txt"]))
    text = path.read_text()
    text = mutate_table(text.replace(" ", ","), random).replace(",", " ")
    text = mutate_text(text, random) if random.random() < 0.2 else text
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    period = ["--period", pick(random, ["0.1", "1e308", "1e-320"])] if random.random() < 0.4 else []
    return ["pem", "convert", "vehicles.txt", "labels.txt", "--out", "made", *period]


def _model(random):
    path = Path("pem.npz")
    path.write_bytes(damage.damage_arrays(path.read_bytes(), random))
    return ["pem", "score", "pem.npz", "detections.csv", *pick(random, [[], ["--json"]])]


def _samples(random):
    if random.random() < 0.5:
        _table(Path("samples.csv"), random)
        return ["flow", "fit", "samples.csv", "--steps", "1", "--out", "f"]
    path = Path("samples.npy")
    archive = io.BytesIO()
    np.savez(archive, arr_0=np.load(path))
    try:
        with zipfile.ZipFile(io.BytesIO(damage.damage_arrays(archive.getvalue(), random))) as file:
            path.write_bytes(file.read(file.namelist()[0]))
    except (zipfile.BadZipFile, IndexError, EOFError, ValueError, NotImplementedError):
        path.write_bytes(damage.damage_bytes(path.read_bytes(), random))
    return FLOW


def _policy(random):
    path = Path(pick(random, ["policy.zip", "policy.pt"]))
    content = path.read_bytes()
    for _ in range(random.integers(1, 4)):
        content = damage.damage_bytes(content, random) or b"x"
    path.write_bytes(content)
    activation = ["--activation", "tanh"] if path.suffix == ".pt" else []
    return ["policy", "convert", str(path), "--out", "converted", *activation]


def make() -> None:
    """Write the undamaged files into the current folder."""
    random = np.random.default_rng(0)
    rows = _rows(random, 300)
    names = list(rows)
    lines = [",".join(f"{x:.4g}" for x in row) for row in zip(*rows.values(), strict=True)]
    Path("detections.csv").write_text("\n".join([",".join(names), *lines]) + "\n")
    for file, columns in (
        ("vehicles.txt", ["right", "forward", "yaw", "length", "width", "height", "visibility"]),
        ("labels.txt", ["detected", "error_right", "error_forward", "error_yaw"]),
    ):
        many = zip(*(rows[name][:30] for name in columns), strict=True)
        Path(file).write_text("\n".join(" ".join(f"{x:.4g}" for x in row) for row in many) + "\n")
    samples = random.normal(size=(60, 2))
    np.save("samples.npy", samples)
    np.savetxt("samples.csv", samples, fmt="%.4f", delimiter=",", header="a,b", comments="")
    _make_policies()


def _rows(random, n):
    distance, bearing = random.uniform(3, 80, n), random.uniform(-np.pi, np.pi, n)
    detected = random.uniform(size=n) < 1 / (1 + np.exp((distance - 45) / 5))
    error = detected * (0.05 + 0.006 * distance) * random.standard_t(4, (2, n))
    return {
        "right": distance * np.cos(bearing),
        "forward": distance * np.sin(bearing),
        "yaw": random.uniform(-np.pi, np.pi, n),
        "length": random.normal(4.6, 0.3, n),
        "width": random.normal(1.9, 0.1, n),
        "height": random.normal(1.7, 0.1, n),
        "visibility": random.integers(1, 5, n).astype(float),
        "detected": detected.astype(float),
        "error_right": error[0],
        "error_forward": error[1],
        "error_yaw": detected * np.abs(0.02 * random.standard_t(4, n)),
    }


def _make_policies():
    import torch

    torch.manual_seed(0)
    body = torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.Tanh(), torch.nn.Linear(4, 1))
    torch.save(body.state_dict(), "policy.pt")
    weights = body.state_dict()
    named = {"mlp_extractor.policy_net.0": "0", "action_net": "2"}
    parts = {
        f"{name}.{part}": weights[f"{i}.{part}"] for name, i in named.items() for part in ("weight", "bias")
    }
    content = io.BytesIO()
    torch.save(parts, content)
    with zipfile.ZipFile("policy.zip", "w") as file:
        file.writestr("data", "{}")
        file.writestr("policy.pth", content.getvalue())
