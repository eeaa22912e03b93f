"""All that the panels and the scene need to show one view: computed once, read by each of them."""

from dataclasses import dataclass

from app.state.library import Opened
from app.state.view import View
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.sensors import ColorImage
from fusion_core.workflows.frame import FrameMatch, FusedFrame
from fusion_core.workflows.live import FrameChoice, LiveChain
from fusion_core.workflows.pairing import PairedImage


@dataclass(frozen=True, kw_only=True)
class Shown:
    """One view and what came of it. What could not be had is None, and ``failure`` says why.

    ``chain`` is None while the recording is being aligned.
    """

    view: View
    opened: Opened
    chain: LiveChain | None = None
    paired: PairedImage | None = None
    match: FrameMatch | None = None
    fused: FusedFrame | None = None
    color: ColorImage | None = None
    failure: ScanLoomError | None = None


def clock_offset_ms(view: View, chain: LiveChain) -> float:
    """The offset that is taken out of the camera's stamps: the mount's, where asked for."""
    return chain.alignment.mount.clock_offset_ms if view.apply_clock_offset else 0.0


def shown_of(view: View, opened: Opened) -> Shown:
    """Compute a view; a stage that fails leaves what came before it.

    A frame beyond the recording's last, as an old link may ask for, is its last.
    """
    view = view.model_copy(update={"number": min(view.number, len(opened.frames) - 1)})
    chain = opened.chain
    if chain is None:
        failure = opened.failure if isinstance(opened.failure, ScanLoomError) else None
        return Shown(view=view, opened=opened, failure=failure)
    choice = FrameChoice(
        number=view.number,
        clock_offset_ms=clock_offset_ms(view, chain),
        picked=view.picked,
    )
    paired = match = fused = color = None
    failure = None
    try:
        paired = chain.paired(choice)
        color = opened.frames.color(choice.number)
        match = chain.matched(choice, view.settings)
        fused = chain.judged(choice, view.settings)
    except ScanLoomError as error:
        failure = error
    return Shown(
        view=view,
        opened=opened,
        chain=chain,
        paired=paired,
        match=match,
        fused=fused,
        color=color,
        failure=failure,
    )
