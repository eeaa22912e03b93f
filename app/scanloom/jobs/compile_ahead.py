"""Compiles what the first picture of an aligned recording needs, at set-up.

    python -m scanloom.jobs.compile_ahead

The built-in recording is aligned and its first frame fused. What is compiled is kept beside the
sources (``fusion_core.compiled``), so that the workbench does not compile when it is first opened.
"""

from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.cached_chain import CachedChain
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS
from fusion_core.workflows.source import open_source
from scanloom.resources import sample_path


def compile_ahead() -> None:
    """Align the built-in recording and fuse a frame of it."""
    with open_source(sample_path(), None) as recording:
        session = open_session(recording, FuseOptions(), PRESETS["default"])
        chain = CachedChain(session, FrameReader(session), align_recording(session))
        chain.prepare()


if __name__ == "__main__":
    compile_ahead()
