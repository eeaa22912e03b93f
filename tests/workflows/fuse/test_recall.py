"""The recall curve of a live chain is that of ``evaluate`` on a folder that ``fuse`` wrote."""

import json

import numpy as np
import pytest

from fusion_core.model.errors import ScanLoomError
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.evaluate import evaluate
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.cached_chain import CachedChain
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.recall import recall_of, truth_beside
from fusion_core.workflows.fuse.session import (
    FuseOptions,
    open_session,
)
from fusion_core.workflows.fuse.settings import PRESETS


@pytest.fixture(scope="module")
def chain(bedroom):
    with open_recording(bedroom.recording) as recording:
        session = open_session(recording, FuseOptions(), PRESETS["default"])
        yield CachedChain(session, FrameReader(session), align_recording(session))


def test_the_curve_is_that_of_evaluate(bedroom, chain):
    expected = evaluate.noise(bedroom.folder, bedroom.truth)["over_epsilon"]
    curve = recall_of(chain, PRESETS["default"], bedroom.truth).to_json()
    assert curve == json.loads(json.dumps(expected))
    assert curve["good_pairs"] > 100
    assert curve["noise_pairs"] > 0


@pytest.mark.slow
def test_epsilon_changes_nothing_and_the_map_does(bedroom, chain):
    def curve(stage, **values):
        settings = PRESETS["default"]
        changed = getattr(settings, stage).model_copy(update=values)
        found = recall_of(chain, settings.model_copy(update={stage: changed}), bedroom.truth)
        return found.to_json()

    own = recall_of(chain, PRESETS["default"], bedroom.truth).to_json()
    assert curve("noise", epsilon=9.0) == own
    assert curve("registration", model="affine") != own


def test_progress_goes_over_all_frames_and_may_stop_there(bedroom, chain):
    class Stop(Exception):
        pass

    seen = []

    def progress(done, total, what):
        seen.append((done, total))
        if done == 5:
            raise Stop

    with pytest.raises(Stop):
        recall_of(chain, PRESETS["default"], bedroom.truth, 0.0, progress)
    assert seen == [(done, len(chain.frames)) for done in range(6)]


def test_another_recordings_truth_is_refused_before_any_frame(chain, scenes):
    other = truth_beside(scenes("furnished_room", duration_s=1.0, image_scale=0.25))
    calls = []
    with pytest.raises(ScanLoomError) as refused:
        recall_of(chain, PRESETS["default"], other, 0.0, lambda *step: calls.append(step))
    assert str(refused.value).startswith(str(other))
    assert calls == []


def test_a_truth_is_found_by_its_name(tmp_path):
    for name in ("room.mcap", "room_2.bag", "room_3"):
        recording = tmp_path / name
        assert truth_beside(recording) is None
        truth = tmp_path / f"{recording.stem}.truth.npz"
        np.savez(truth, a=1)
        assert truth_beside(recording) == truth
