"""Which recordings a batch finds, and that their names are unique and stable."""

import random
import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.errors import ExportError, RecordingError
from fusion_core.workflows.batch.item_names import item_names
from fusion_core.workflows.batch.items import find_items
from tests.recordings.robot_at_home_trees import small_room, write_plain_text

MCAP_MAGIC = b"\x89MCAP0\r\n"
BAG_MAGIC = b"#ROSBAG V2.0\n"
PARTS = st.text(alphabet="aAbß-._ é\udcff", min_size=1, max_size=4)
PATHS = st.lists(
    st.lists(PARTS, min_size=1, max_size=3).map("/".join), min_size=1, max_size=12, unique=True
)


def write(path: Path, content: bytes = MCAP_MAGIC) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def found(*sources: object, **options: Path) -> dict[str, str]:
    """Robot of each recording that is found."""
    items = find_items([str(source) for source in sources], **options)
    return {item.recording: item.robot for item in items}


@given(PATHS)
def test_names_are_unique_where_case_is_ignored_and_are_names_of_files(paths: list[str]) -> None:
    names = item_names(paths)
    assert len({name.casefold() for name in names}) == len(paths)
    for name in names:
        assert name not in ("", ".", "..")
        assert not name.startswith(".")
        assert len(f".{name}.12345678.partial.json".encode()) <= 255
        assert not set(name) & set('/\\:*?"<>|\0 \udcff')


@given(PATHS, st.randoms(use_true_random=False))
def test_names_do_not_depend_on_the_order(paths: list[str], order: random.Random) -> None:
    shuffled = order.sample(paths, len(paths))
    assert dict(zip(shuffled, item_names(shuffled), strict=True)) == dict(
        zip(paths, item_names(paths), strict=True)
    )


def test_a_name_is_readable() -> None:
    assert item_names(["robot 1/run_1.mcap", "room_2.bag"]) == ("robot_1-run_1.mcap", "room_2.bag")


def test_names_that_would_be_the_same_keep_their_text() -> None:
    first, second, third = item_names(["a/b.bag", "a-b.bag", "c.bag"])
    assert first.startswith("a-b.bag-")
    assert second.startswith("a-b.bag-")
    assert third == "c.bag"


def test_a_folder_is_searched_by_content(tmp_path: Path) -> None:
    write(tmp_path / "robot_1" / "one.mcap")
    write(tmp_path / "robot_1" / "without_suffix", BAG_MAGIC)
    write(tmp_path / "robot_2" / "deep" / "two.bag", b"no bag at all")
    write(tmp_path / "robot_2" / "notes.txt", b"nothing")
    write(tmp_path / "robot_2" / ".hidden" / "three.mcap")
    write(tmp_path / "top.mcap", b"")
    assert found(tmp_path) == {
        "robot_1/one.mcap": "robot_1",
        "robot_1/without_suffix": "robot_1",
        "robot_2/deep/two.bag": "deep",
        "top.mcap": "",
    }


def test_a_folder_that_is_a_recording_is_one(tmp_path: Path) -> None:
    write(tmp_path / "robot" / "run" / "run_0.mcap")
    write(tmp_path / "robot" / "run" / "run_1.mcap")
    write(tmp_path / "robot" / "told" / "metadata.yaml", b"rosbag2_bagfile_information: {}\n")
    write(tmp_path / "robot" / "told" / "any.mcap")
    write(tmp_path / "robot" / "several" / "a.mcap")
    write(tmp_path / "robot" / "several" / "b.mcap")
    assert list(found(tmp_path)) == [
        "robot/run",
        "robot/several/a.mcap",
        "robot/several/b.mcap",
        "robot/told",
    ]
    assert found(tmp_path / "robot" / "run") == {"run": ""}


def test_results_of_an_earlier_run_are_no_recordings(tmp_path: Path) -> None:
    write(tmp_path / "run.mcap")
    write(tmp_path / "results" / "repaired.mcap")
    write(tmp_path / "results" / "manifest.json", b'{"project": "scanloom"}')
    assert list(found(tmp_path)) == ["run.mcap"]


def test_links_that_form_a_loop_are_searched_once(tmp_path: Path) -> None:
    write(tmp_path / "data" / "run.mcap")
    (tmp_path / "data" / "again").symlink_to(tmp_path / "data")
    assert list(found(tmp_path / "data")) == ["run.mcap"]


def test_the_same_recording_named_twice_is_one(tmp_path: Path) -> None:
    run = write(tmp_path / "robot" / "run.mcap")
    assert found(tmp_path, run, tmp_path / "robot" / ".." / "robot" / "run.mcap") == {
        "robot/run.mcap": "robot"
    }


def test_a_pattern_matches_recordings_alone(tmp_path: Path) -> None:
    write(tmp_path / "robot_1" / "one.mcap")
    write(tmp_path / "robot_1" / "one.txt", b"a text")
    write(tmp_path / "robot_2" / "two.mcap")
    write(tmp_path / "other" / "three.mcap")
    assert found(f"{tmp_path}/robot_*/*") == {
        "robot_1/one.mcap": "robot_1",
        "robot_2/two.mcap": "robot_2",
    }


def test_a_list_keeps_what_is_missing(tmp_path: Path) -> None:
    run = write(tmp_path / "run.mcap")
    lines = tmp_path / "list.txt"
    lines.write_text(f"# of last week\n{run}\n\n{tmp_path}/gone.mcap\n")
    assert list(found(list_file=lines)) == ["gone.mcap", "run.mcap"]


def test_each_room_of_a_data_set_is_one(tmp_path: Path) -> None:
    rooms = [small_room(), small_room(session="alma-s2", room="kitchen1", seed=1)]
    root = write_plain_text(tmp_path / "home", rooms)
    items = find_items([str(root)])
    assert [str(item.room) for item in items] == ["alma-s1_bedroom1", "alma-s2_kitchen1"]
    assert [item.robot for item in items] == ["alma-s1", "alma-s2"]
    assert {item.place for item in items} == {str(root)}


@pytest.mark.parametrize(
    ("sources", "problem"),
    [
        ([], "no recording is named"),
        (["gone.mcap"], "does not exist"),
        (["*.mcap"], "matches no recording"),
        (["empty"], "is a folder without a recording"),
    ],
)
def test_nothing_found_is_said(
    sources: list[str], problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RecordingError, match=problem):
        find_items(sources)


@pytest.mark.parametrize("output", ["data", "data/out", ".", "run.mcap"])
def test_an_output_among_the_recordings_is_refused(output: str, tmp_path: Path) -> None:
    write(tmp_path / "data" / "one.mcap")
    shutil.copy(tmp_path / "data" / "one.mcap", tmp_path / "run.mcap")
    sources = [str(tmp_path / "data"), str(tmp_path / "run.mcap")]
    with pytest.raises(ExportError, match="the input"):
        find_items(sources, output=tmp_path / output)
    assert len(find_items(sources, output=tmp_path / "beside")) == 2
