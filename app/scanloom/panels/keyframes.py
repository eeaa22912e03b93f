"""The keyframes of a run of visual SLAM: two of them with their images, and what both see."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import viser

from fusion_core.model.conventions import NS_PER_MS, NS_PER_S, ByteArray
from fusion_core.workflows.map.image_lookup import ImageLookup
from fusion_core.workflows.map.visual_result_folder import VisualResults
from scanloom.client_session import ClientSession
from scanloom.jobs.latest_only_worker import LatestOnlyWorker
from scanloom.jobs.slam_run import SlamRun
from scanloom.page.markup import paragraph
from scanloom.page.update_widget import update_widget
from scanloom.panels.visual_stage import VisualStage
from scanloom.plots.keyframe_matches import LINES_MAX, keyframe_matches_picture
from scanloom.plots.palette import color_of
from scanloom.plots.png import show_picture
from scanloom.plots.theme import LIGHT, Theme
from scanloom.scene.visual_nodes import PickedKeyframe
from scanloom.state.open_recording import OpenRecording

_WIDTH_PX = 400
# Wide enough for a frustum, which is small on the screen.
_FRUSTUM_PX = 320
_NO_LOOP = "none chosen"
_EMPTY = np.full((2, 2, 3), 255, dtype=np.uint8)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pair:
    """What is to be shown: two keyframes of a run, with the images of its recording."""

    run: SlamRun
    visual: VisualResults
    opened: OpenRecording
    first: int
    second: int
    theme: Theme


class KeyframesPanel:
    """Chooses two keyframes; ``show`` is called in the session's worker thread."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession, stage: VisualStage) -> None:
        self._session, self._stage = session, stage
        self._lock = threading.RLock()
        self._run: SlamRun | None = None
        self._opened: OpenRecording | None = None
        self._theme = LIGHT
        self._first = self._second = 0
        self._images: tuple[SlamRun, ImageLookup] | None = None
        self._folder = gui.add_folder("Keyframes", visible=False)
        with self._folder:
            self._first_slider = gui.add_slider(
                "Keyframe",
                min=1,
                max=2,
                step=1,
                initial_value=1,
                hint="A keyframe by its number; a click on one in the scene chooses it, too",
            )
            self._second_slider = gui.add_slider(
                "Compared with",
                min=1,
                max=2,
                step=1,
                initial_value=1,
                hint="Another keyframe; at first the one that sees most of the same landmarks",
            )
            self._loop = gui.add_dropdown(
                "Loop",
                (_NO_LOOP,),
                hint="Two keyframes that have seen the same place again, and how many matches "
                "agree with it",
            )
            self._picture = gui.add_image(_EMPTY, format="png", visible=False)
            self._words = gui.add_html("")
        self._drawing = LatestOnlyWorker("keyframes", self._draw, session.show_failure)
        stage.on_keyframe = self.choose
        self._bind(self._first_slider, lambda value: self.choose(int(value) - 1))
        self._bind(self._second_slider, self._compare)
        self._bind(self._loop, self._choose_loop)

    def show(self, run: SlamRun | None, opened: OpenRecording, theme: Theme) -> None:
        """The keyframes of a run, None for none."""
        with self._lock:
            visual = None if run is None else run.visual
            count = 0 if visual is None else visual.stamps_ns.size
            update_widget(self._folder, visible=count > 0)
            if run is None or visual is None or not count:
                self._run = None
                return
            is_changed = run is not self._run or theme is not self._theme
            self._opened, self._theme = opened, theme
            if run is not self._run:
                self._run = run
                self._offer(visual)
            if is_changed:
                self._submit()

    def choose(self, keyframe: int) -> None:
        """Choose a keyframe, and compare it with the one that sees most of the same."""
        with self._lock:
            visual = self._visual
            if visual is None or not 0 <= keyframe < visual.stamps_ns.size:
                return
            counts = visual.shared_counts(keyframe)
            self._first, self._second = keyframe, int(counts.argmax())
            self._set_sliders()
            update_widget(self._loop, value=_NO_LOOP)
            self._submit()

    def close(self) -> None:
        """Draw nothing more."""
        self._drawing.close()

    @property
    def _visual(self) -> VisualResults | None:
        return None if self._run is None else self._run.visual

    def _bind(self, handle: Any, change: Callable[[Any], None]) -> None:
        @handle.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            # Without a client the panel itself has set the value.
            if event.client is not None:
                change(handle.value)

    def _offer(self, visual: VisualResults) -> None:
        """Set what can be chosen of a run, and begin in its middle."""
        count = int(visual.stamps_ns.size)
        for slider in (self._first_slider, self._second_slider):
            # A slider needs two places.
            update_widget(slider, max=max(count, 2), disabled=count < 2)
        names = [_loop_name(visual, loop) for loop in range(len(visual.loops))]
        update_widget(self._loop, options=(_NO_LOOP, *names), visible=bool(names))
        update_widget(self._loop, value=_NO_LOOP)
        self._first = count // 2
        self._second = int(visual.shared_counts(self._first).argmax())
        self._set_sliders()

    def _set_sliders(self) -> None:
        update_widget(self._first_slider, value=self._first + 1)
        update_widget(self._second_slider, value=self._second + 1)

    def _compare(self, value: Any) -> None:
        with self._lock:
            visual = self._visual
            if visual is not None and 1 <= int(value) <= visual.stamps_ns.size:
                self._second = int(value) - 1
                update_widget(self._loop, value=_NO_LOOP)
                self._submit()

    def _choose_loop(self, value: Any) -> None:
        with self._lock:
            visual = self._visual
            if visual is None:
                return
            names = [_loop_name(visual, loop) for loop in range(len(visual.loops))]
            if value in names:
                self._first, self._second = map(int, visual.loops[names.index(value)])
                self._set_sliders()
                self._submit()

    def _submit(self) -> None:
        run, visual, opened = self._run, self._visual, self._opened
        if run is None or visual is None or opened is None:
            return
        self._drawing.submit(
            _Pair(
                run=run,
                visual=visual,
                opened=opened,
                first=self._first,
                second=self._second,
                theme=self._theme,
            )
        )

    def _draw(self, pair: _Pair, is_newest: Callable[[], bool]) -> None:
        images = self._images_of(pair)
        numbers = pair.first, pair.second
        visual = pair.visual
        first, second = (images.at(int(visual.stamps_ns[number])) for number in numbers)
        pixels = visual.matches(*numbers)
        titles = tuple(_title(visual, number) for number in numbers)
        picture = keyframe_matches_picture(
            (first, second), pixels, (titles[0], titles[1]), width_px=_WIDTH_PX, theme=pair.theme
        )
        if not is_newest():
            return
        colors = color_of("depth"), color_of("lidar")
        frusta = [
            PickedKeyframe(
                T_map_camera=visual.T_map_camera[number], image=_small(image), color=color
            )
            for number, image, color in zip(numbers, (first, second), colors, strict=True)
        ]
        with self._lock, self._session.batch_updates():
            if pair.run is not self._run:
                return
            show_picture(self._picture, picture)
            update_widget(self._picture, visible=True)
            update_widget(self._words, content=paragraph(match_text(visual, *numbers)))
            self._stage.pick(frusta if pair.first != pair.second else frusta[:1])

    def _images_of(self, pair: _Pair) -> ImageLookup:
        held = self._images
        if held is None or held[0] is not pair.run:
            offset_ns = round(pair.run.options.clock_offset_ms * NS_PER_MS)
            opened = pair.opened
            images = ImageLookup(
                opened.recording,
                opened.opened.streams,
                clock_offset_ns=offset_ns,
                color_zoom=float(pair.run.files.report.get("color_zoom", 1.0)),
            )
            held = self._images = pair.run, images
        return held[1]


def match_text(visual: VisualResults, first: int, second: int) -> str:
    """How much two keyframes have in common, as text."""
    if first == second:
        return f"Keyframe {first + 1} alone: choose another one to compare it with."
    count = len(visual.matches(first, second)[0])
    apart_m = float(
        np.linalg.norm(visual.T_map_camera[first, :3, 3] - visual.T_map_camera[second, :3, 3])
    )
    where = f"Their cameras are {apart_m:.2f} m apart."
    if not count:
        return f"Keyframes {first + 1} and {second + 1} see no landmark in common. {where}"
    drawn = f", of which {LINES_MAX} are drawn" if count > LINES_MAX else ""
    landmarks = "1 landmark" if count == 1 else f"{count} landmarks"
    return f"Both see {landmarks}{drawn}. {where}"


def _title(visual: VisualResults, number: int) -> str:
    since_s = (visual.stamps_ns[number] - visual.trajectory.stamps_ns[0]) / NS_PER_S
    features = int(visual.offsets[number + 1] - visual.offsets[number])
    return f"keyframe {number + 1} at {since_s:.2f} s, {features:,} features"


def _loop_name(visual: VisualResults, loop: int) -> str:
    first, second = visual.loops[loop] + 1
    return f"{loop + 1}: {first} and {second}, {visual.loop_inliers[loop]} matches"


def _small(image: ByteArray) -> ByteArray:
    height = max(1, round(_FRUSTUM_PX * image.shape[0] / image.shape[1]))
    small = cv2.resize(image, (_FRUSTUM_PX, height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)
