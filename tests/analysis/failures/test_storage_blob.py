"""Blobs: to the last bit there and back, and one clear line for everything else."""

import base64
import json
import zlib
from dataclasses import replace

import numpy as np
import pytest

from avrare.analysis.failures.failure import record_failure, round_values
from avrare.analysis.failures.storage import PREFIX, decode, encode
from avrare.base.errors import UsageError


@pytest.fixture
def failure(linear, pushed):
    return record_failure(linear, "near", pushed)


def content(blob):
    word = blob.removeprefix(PREFIX)
    return zlib.decompress(base64.urlsafe_b64decode(word + "=" * (-len(word) % 4)))


def blob_of(content):
    return PREFIX + base64.urlsafe_b64encode(zlib.compress(content)).decode().rstrip("=")


def test_a_failure_is_decoded_bit_for_bit(failure):
    again = decode(encode(failure))
    assert again.id == failure.id
    assert (again.parts, again.versions, again.columns) == (failure.parts, failure.versions, failure.columns)
    assert again.robustness == failure.robustness
    for name in ("noise", "checksums", "values"):
        np.testing.assert_array_equal(getattr(again, name), getattr(failure, name), strict=True)


def test_nan_and_infinite_values_survive(failure):
    values = round_values(np.array([[np.inf, -np.inf, 1e300], [0.0, -0.0, 1e-300]]))
    odd = replace(
        failure,
        noise=failure.noise[:2],
        checksums=failure.checksums[:2],
        columns=("a", "b", "c"),
        values=values,
    )
    again = decode(encode(replace(odd, robustness=-np.inf)))
    np.testing.assert_array_equal(again.values, values)
    assert again.robustness == -np.inf


def test_the_noise_makes_the_name_and_the_versions_do_not(failure):
    other = replace(failure, versions={"avrare": "9"}, robustness=0.5)
    assert other.id == failure.id
    noise = failure.noise.copy()
    noise[3, 2] = np.nextafter(noise[3, 2], 9.0)
    assert replace(failure, noise=noise).id != failure.id
    assert replace(failure, parts={**failure.parts, "simulator": "00000000"}).id != failure.id


def test_a_blob_of_little_noise_is_short(linear, failure):
    noise = np.zeros((21, 6))
    noise[:, 3] = 3.0
    assert len(encode(record_failure(linear, "near", noise))) < 0.5 * len(encode(failure))


def test_every_damage_is_one_clear_line(failure):
    blob = encode(failure)
    rng = np.random.default_rng(0)
    damaged = [blob[: int(cut)] for cut in rng.integers(0, len(blob), 40)]
    for place in rng.integers(len(PREFIX), len(blob), 60):
        letter = "A" if blob[place] != "A" else "B"
        damaged.append(blob[:place] + letter + blob[place + 1 :])
    damaged += [blob + "ä", blob[:50] + "*" + blob[51:], "", "hello", PREFIX, PREFIX + "AAAA"]
    for text in damaged:
        with pytest.raises(UsageError) as caught:
            decode(text)
        assert "\n" not in caught.value.message
        assert len(caught.value.message) < 200


def test_false_headers_are_refused(failure):
    whole = content(encode(failure))
    size = int.from_bytes(whole[:4], "little")
    header, body = json.loads(whole[4 : 4 + size]), whole[4 + size :]
    assert decode(blob_of(whole)).id == failure.id
    lies = [
        {"shapes": {**header["shapes"], "noise": [10**9, 10**9]}},
        {"shapes": {**header["shapes"], "noise": [-21, -6]}},
        {"shapes": {**header["shapes"], "noise": [126]}},
        {"shapes": {**header["shapes"], "checksums": [20]}},
        {"shapes": None},
        {"columns": ["x"]},
        {"robustness": "low"},
        {"parts": 3},
    ]
    for lie in lies:
        text = json.dumps({**header, **lie}).encode()
        with pytest.raises(UsageError, match="the blob is damaged"):
            decode(blob_of(len(text).to_bytes(4, "little") + text + body))
    with pytest.raises(UsageError, match="header"):
        decode(blob_of((5).to_bytes(4, "little") + b"[[[[[" + body))


def test_control_characters_in_a_blob_are_escaped(failure):
    odd = replace(
        failure, columns=("\x1b]0;x\x07", *failure.columns[1:]), versions={"a\x9b1m": "caf\u00e9\u200d"}
    )
    again = decode(encode(odd))
    assert again.columns[0] == r"\x1b]0;x\x07"
    assert again.versions == {r"a\x9b1m": "caf\u00e9\u200d"}
