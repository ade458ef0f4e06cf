"""Reading and cleaning tables: what is understood, and what is said of a broken one."""

from dataclasses import replace

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare_pem_training.cleaning import clean, find_artefact
from avrare_pem_training.table import errors_in, read_table, write_table
from avrare_pem_training.text_tables import convert

HEADER = "right,forward,yaw,length,width,height,visibility,detected,error_right,error_forward,error_yaw"
GOOD = "1.5,20,1.5,4.5,1.8,1.6,4,1,0.1,-0.2,0.01"
MISSED = "1.5,30,1.5,4.5,1.8,1.6,4,0,,,"


def file(tmp_path, *lines):
    path = tmp_path / "data.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_good_file(tmp_path):
    rows = read_table(file(tmp_path, HEADER, GOOD, "", MISSED))
    np.testing.assert_array_equal(rows.detected, [True, False])
    np.testing.assert_array_equal(rows.forward, [20, 30])
    np.testing.assert_array_equal(rows.error_forward, [-0.2, np.nan])


def test_optional_columns_and_detected_boxes(tmp_path):
    header = "detected,width,length,yaw,forward,right,detected_right,detected_forward,detected_yaw,note"
    lines = ("1,1.8,4.5,3.1,20,1,0.75,20.5,-3.1,hello", "0,1.8,4.5,3.1,20,1,,,,")
    rows = read_table(file(tmp_path, header, *lines))
    np.testing.assert_allclose([rows.error_right[0], rows.error_forward[0]], [0.25, -0.5])
    np.testing.assert_allclose(rows.error_yaw[0], 6.2 - 2 * np.pi)
    np.testing.assert_array_equal([rows.height[0], rows.visibility[0]], [1.7, 4.0])


@pytest.mark.parametrize(
    ("header", "hint"),
    [
        (HEADER.replace("forward,yaw", "forward,yow"), "is it the column 'yow'?"),
        ("# Format: <loc_x> <loc_y> <rot>", "avrare pem convert"),
        ("right,forward,yaw,length,width,detected", "needed are right"),
    ],
)
def test_a_missing_column_has_a_hint(tmp_path, header, hint):
    with pytest.raises(UsageError) as caught:
        read_table(file(tmp_path, header, GOOD))
    assert hint in caught.value.hint


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "the file is empty"),
        ([HEADER], "there are no rows below the header"),
        ([HEADER.replace("yaw,l", "yow,l"), GOOD], "data.csv:1: missing column 'yaw'"),
        ([HEADER.replace("detected", "seen"), GOOD], "data.csv:1: missing column 'detected'"),
        ([HEADER.replace("width", "length"), GOOD], "data.csv:1: column 'length' occurs twice"),
        ([HEADER, GOOD, GOOD + ",1"], "data.csv:3: 12 values, but the header has 11 columns"),
        ([HEADER, GOOD, "", GOOD.replace("20", "far")], "csv:4: forward: should be a number, found 'far'"),
        ([HEADER, GOOD, GOOD.replace("20", "nan")], "data.csv:3: forward: is missing or not a number"),
        ([HEADER, GOOD, GOOD.replace("4.5", "")], "data.csv:3: length: is missing"),
        ([HEADER, GOOD.replace("4.5", "4500")], "data.csv:2: length: 4500 is implausible: metres?"),
        ([HEADER, GOOD.replace(",1.5", ",88")], "data.csv:2: yaw: 88 is implausible: radians"),
        ([HEADER, GOOD.replace("20", "2000")], "data.csv:2: forward: 2000 is implausible"),
        ([HEADER, GOOD.replace("4,1", "7,1")], "data.csv:2: visibility: 7 is implausible"),
        ([HEADER, GOOD.replace("4,1", "4,0.5")], "data.csv:2: detected: 0.5 is implausible: 0 or 1?"),
        ([HEADER, MISSED, GOOD.replace("0.1", "-1000")], "data.csv:3: error_right: -1000 is implausible"),
        ([HEADER, GOOD.replace("-0.2", "")], "data.csv:2: error_forward: is missing"),
    ],
)  # fmt: skip
def test_a_broken_file_names_the_line(tmp_path, lines, message):
    path = file(tmp_path, *lines)
    path.write_text(path.read_text() if lines else "")
    with pytest.raises(UsageError) as caught:
        read_table(path)
    assert message in caught.value.message


def test_writing_and_reading_back_changes_nothing(tmp_path, drive):
    rows = drive(300)
    write_table(tmp_path / "a.csv", rows)
    again = read_table(tmp_path / "a.csv")
    for name in ("right", "yaw", "visibility", "detected", "error_right", "error_yaw"):
        np.testing.assert_array_equal(getattr(again, name), getattr(rows, name))


def pair(tmp_path, inputs, labels):
    (tmp_path / "in.txt").write_text(inputs)
    (tmp_path / "out.txt").write_text(labels)
    return tmp_path / "in.txt", tmp_path / "out.txt"


def test_two_files_without_and_with_names(tmp_path):
    rows = convert(*pair(tmp_path, "1 20 0.5 4.5 1.8 1.6 3\n", "1 0.1 0.2 0.3\n"))
    assert (rows.right[0], rows.forward[0], rows.visibility[0], rows.error_forward[0]) == (1, 20, 3, 0.2)
    named = "# Format: <loc_x> <loc_z> <rot> <dim_l> <dim_w> <occluded>\n"
    labels = "# Format: <detected> <err_loc_x> <err_loc_z> <err_rot>\n"
    named, labels = named + "1 20 0.5 4.5 1.8 0\n2 9 0 4 2 2\n", labels + "1 0.1 0.2 0\n0 -1000 -1000 -1000"
    rows = convert(*pair(tmp_path, named, labels))
    np.testing.assert_array_equal(rows.visibility, [4, 1])
    np.testing.assert_array_equal(rows.error_right, [0.1, np.nan])
    np.testing.assert_array_equal(rows.height, [1.7, 1.7])
    rows = convert(*pair(tmp_path, "1 20 0.5 4.5 1.8 1\n", "1 0.1 0.2 0.3\n"))
    assert (rows.forward[0], rows.visibility[0]) == (20, 2)


@pytest.mark.parametrize("header", ["", "# <loc_x> <loc_z> <rot> <dim_l> <dim_w> <occlusion>\n",
                                    "# <loc_x> <loc_z> <rot_y> <dim_l> <dim_w> <occlusion>\n"])  # fmt: skip
def test_a_rotation_about_the_cameras_y_axis_is_clockwise(tmp_path, header):
    # KITTI: x right, y down, z forward; rotation_y is 0 for a car that faces right, -pi/2 for one ahead that
    # drives away, and it turns x towards -z: the direction is (cos r, -sin r) to the right and forward
    angles = [0.0, -np.pi / 2, np.pi / 2, -0.3]
    inputs = header + "".join(f"1 20 {r} 4.5 1.8 0\n" for r in angles)
    rows = convert(*pair(tmp_path, inputs, "1 0.1 0.2 0.04\n" * 4))
    np.testing.assert_allclose(rows.yaw, [0.0, np.pi / 2, -np.pi / 2, 0.3])
    np.testing.assert_allclose(np.cos(rows.yaw), np.cos(angles))
    np.testing.assert_allclose(np.sin(rows.yaw), -np.sin(angles), atol=1e-15)
    np.testing.assert_allclose(rows.error_yaw, -0.04)
    along = errors_in("vehicle", rows)[3, 0]  # the box's own axis points a little to the left
    assert along == pytest.approx(np.cos(0.3) * 0.1 + np.sin(0.3) * 0.2)


@pytest.mark.parametrize(
    ("inputs", "labels", "message"),
    [
        ("1 20 0.5 4.5 1.8 1.6 3\n", "1 0 0 0\n1 0 0 0\n", "are not a pair"),
        ("1 20 0.5\n", "1 0 0 0\n", "in.txt:1: 3 numbers, expected 7"),
        ("1 20 0.5 4.5 1.8 1.6 3\n", "1 0 x 0\n", "out.txt:1: could not convert"),
        ("# Format: <moon>\n1\n", "1 0 0 0\n", "in.txt: no column gives right, forward, yaw, length, width"),
        ("\n", "1 0 0 0\n", "no rows"),
        ("# <loc_x> <loc_y>\n1 2\n", "1 0 0 0\n", "no column gives yaw"),
        ("1 inf 0.5 4.5 1.8 1.6 3\n", "1 0 0 0\n", "in.txt:1: forward: inf is implausible"),
        ("1 20 0.5 4.5 1.8 1.6 3\n", "\n1 nan 0 0\n", "out.txt:2: error_right: is missing"),
        ("1 20 0.5 4.5 1.8 1.6 3\n", "0.5 0 0 0\n", "out.txt:1: detected: 0.5 is implausible"),
        ("1 20 0.5 4.5 1.8 0\n1 20 0.5 4.5 1.8 -1\n", "1 0 0 0\n1 0 0 0\n", "in.txt:2: occlusion: -1 is not"),
    ],
)
def test_broken_pairs_name_the_line(tmp_path, inputs, labels, message):
    with pytest.raises(UsageError) as caught:
        convert(*pair(tmp_path, inputs, labels))
    assert message in caught.value.message


def test_duplicates_are_dropped_within_and_across_the_split(drive):
    rows = drive(1000)
    index = np.concatenate([np.arange(900), np.arange(20), [950], np.arange(900, 1000)])
    twice = rows.take(index)
    data = clean(twice, artefact=False)
    assert len(data.test) == len(twice) - int(0.8 * len(twice))
    assert data.dropped == 20  # those that come again among the held-out rows
    assert not set(data.train.right) & set(data.test.right)
    assert data.test_oblique.sum() == len(set(data.test.right))
    assert data.oblique.all()


def test_the_artefact_is_found_where_present(drive):
    assert not find_artefact(drive(4000)).present
    found = find_artefact(drive(4000, artefact=True))
    assert found.present
    assert found.aligned < 0.6 * found.oblique
    data = clean(drive(4000, artefact=True))
    assert data.has_artefact
    angle = np.abs((np.degrees(data.train.yaw) + 45) % 90 - 45)
    np.testing.assert_array_equal(data.oblique, angle >= 10)
    assert not clean(drive(4000, artefact=True), artefact=False).has_artefact


def test_a_good_detector_is_accepted(drive):
    rows = drive(1500, artefact=True)
    angle = np.abs((np.degrees(rows.yaw) + 45) % 90 - 45)
    sharp = (angle >= 10) & (np.arange(len(rows)) % 100 > 0)  # off the axes hardly anything is missed
    errors = {name: np.where(sharp, 0.1, getattr(rows, name)) for name in ("error_right", "error_forward")}
    data = clean(replace(rows, detected=rows.detected | sharp, **errors), artefact=True)
    assert 1 <= (~data.train.detected[data.oblique]).sum() < 25


def test_without_rows_off_the_axes_the_error_has_a_hint(drive):
    rows = drive(1500, artefact=True)
    with pytest.raises(UsageError) as caught:
        clean(replace(rows, yaw=0 * rows.yaw), artefact=True)
    assert "off the axes" in caught.value.message
    assert "--artefact no" in caught.value.hint
