"""Two people who answer at the same moment."""

import threading
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from fusion_core.model.labels import Capture, Label
from fusion_core.model.progress import silent
from scanloom.client_session import ClientSession
from scanloom.panels.review_desk import ReviewDesk
from scanloom.state.recording_labels import RecordingLabels
from scanloom.state.view import View
from tests.patience import ENOUGH_S

ANSWERS = 40
SCAN = Capture("lidar", "/scan", 5, 0, 1, ANSWERS)


def desk_of(labels: RecordingLabels, name: str) -> ReviewDesk:
    """A desk whose session shows nothing."""
    session = SimpleNamespace(
        view=View(recording="any", panel="Review"), refresh=lambda: None, frame_view=None
    )
    desk = ReviewDesk(cast(ClientSession, session))
    desk.begin(labels, name, name, silent)
    return desk


@pytest.fixture
def labels(tmp_path: Path) -> RecordingLabels:
    recording = tmp_path / "recording"
    recording.write_bytes(b"any bytes")
    return RecordingLabels(recording)


def test_people_who_answer_at_once_do_not_wait_for_each_other(labels: RecordingLabels) -> None:
    desks = [desk_of(labels, name) for name in ("anna", "ben")]
    together = threading.Barrier(len(desks))

    def answer_all(desk: ReviewDesk) -> None:
        for beam in range(ANSWERS):
            together.wait(ENOUGH_S)
            desk._selection.add(SCAN, np.array([0]), np.array([beam]))
            desk.answer(Label.BURR)

    threads = [threading.Thread(target=answer_all, args=(desk,), daemon=True) for desk in desks]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(ENOUGH_S)
    assert not any(thread.is_alive() for thread in threads)
    for desk in desks:
        assert labels.counts(desk.layer)[Label.BURR] == ANSWERS
    labels.close()
