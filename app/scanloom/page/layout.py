"""Where the page's parts stand: pictures to the left, time below, controls to the right."""

import math
from dataclasses import dataclass

import viser

# Widths of the columns in CSS pixels, for screens at least as wide; set by hand so that the scene
# keeps half of the width.
_WIDE_PX = 1400
_LEFT_PX, _RIGHT_PX = 430, 400
_NARROW_LEFT_PX, _NARROW_RIGHT_PX = 300, 330
# Of the left column where it only says that there are no depth images; viser scrolls narrower ones.
_EMPTY_LEFT_PX = 240
_BOTTOM_PX, _LOW_BOTTOM_PX = 340, 300
_LOW_SCREEN_PX = 800
# Large letters need the higher panel on a projector's screen too.
_LOW_LARGE_SCREEN_PX = 700
_GAP_PX = 12
# Of the legend over the scene; it takes a line, two in a narrow window and three on a phone.
_LEGEND_LINE_PX = 27
# With a smaller scene the floating panel is as wide as this.
_LEAST_WIDTH_PX = 320
# What viser keeps free between a dock and the scene.
_DOCK_EDGE_PX = 4
# viser's frame of the scene, in words that hold before anything is drawn in it.
_SCENE = "[data-dock-root] > div:has(> div > div > div > canvas)"
# What viser takes of a panel for its head and its margins.
_HEAD_PX, _LARGE_HEAD_PX, _MARGIN_PX = 90, 124, 20
# What the time panel shows beside the range profile.
_TIME_PX = 205
# Of the range profile as drawn, whose legend may take two lines.
_LEAST_PROFILE_PX = 110
# Narrower pictures have no room for their scale.
_LEAST_PICTURE_PX = 270
# As the page's style sheet enlarges letters for a projector.
_LARGE = 1.25
# Large controls get a wider column, so that sliders can be dragged, but leave this to the scene.
_SCENE_SHARE = 0.45
# Narrower windows show all panels as sections of one sheet at the bottom, by viser.
_PHONE_PX = 768
# As the page's style sheet limits that sheet.
_SHEET_SHARE = 0.45
FIRST_WINDOW_PX = (1600, 900)
"""What a browser's window is taken for until it has told its size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PageSizes:
    """Sizes in CSS pixels. ``picture_px``: (width, height) of the depth image and the similarity,
    ``profile_px`` of the range profile."""

    left_px: int
    right_px: int
    between_px: int
    bottom_px: int
    picture_px: tuple[int, int]
    profile_px: tuple[int, int]


def page_sizes(
    width_px: int, height_px: int, *, is_large: bool = False, has_depth: bool = True
) -> PageSizes:
    """The sizes for a window of this size. ``is_large``: pictures are drawn smaller, the page
    enlarges them with their letters, and the controls have a wider column. Without depth images
    (``has_depth``) the scene has most of the left column's width."""
    is_wide, is_phone = width_px >= _WIDE_PX, width_px < _PHONE_PX
    left_px, right_px = (_LEFT_PX, _RIGHT_PX) if is_wide else (_NARROW_LEFT_PX, _NARROW_RIGHT_PX)
    if not has_depth:
        left_px = _EMPTY_LEFT_PX
    if is_large:
        free_px = math.floor((1.0 - _SCENE_SHARE) * width_px) - left_px - 2 * _GAP_PX
        right_px = max(min(round(_LARGE * right_px), free_px), right_px)
    low_px = _LOW_LARGE_SCREEN_PX if is_large else _LOW_SCREEN_PX
    bottom_px = _BOTTOM_PX if height_px >= low_px else _LOW_BOTTOM_PX
    between_px = max(width_px - left_px - right_px - 2 * _GAP_PX, _LEAST_WIDTH_PX)
    sheet_px = max(width_px - 2 * _MARGIN_PX, _LEAST_WIDTH_PX)
    picture_width_px = sheet_px if is_phone else left_px - _MARGIN_PX
    zoom = _LARGE if is_large else 1.0
    profile_px = max(bottom_px - _TIME_PX, round(_LEAST_PROFILE_PX * zoom))
    # Both pictures are seen whole, unless they would be flat.
    free_height_px = height_px // 2 - (_LARGE_HEAD_PX if is_large else _HEAD_PX)
    picture_height_px = max(free_height_px, 3 * picture_width_px // 5)
    drawn_width_px = max(picture_width_px / zoom, _LEAST_PICTURE_PX)
    picture_zoom = picture_width_px / drawn_width_px
    profile_width_px = sheet_px if is_phone else between_px - _MARGIN_PX
    return PageSizes(
        left_px=left_px,
        right_px=right_px,
        between_px=between_px,
        bottom_px=bottom_px,
        picture_px=(round(drawn_width_px), round(picture_height_px / picture_zoom)),
        profile_px=(round(profile_width_px / zoom), round(profile_px / zoom)),
    )


def covered_px(width_px: int, height_px: int, *, is_large: bool = False) -> tuple[int, int]:
    """How much of the scene's height lies below the legend, and below the time panel or a phone's
    sheet, for a window of this size. ``is_large``: with large letters."""
    if width_px < _PHONE_PX:
        return 3 * _LEGEND_LINE_PX, round(_SHEET_SHARE * height_px)
    lines = 1 if width_px >= _WIDE_PX else 2
    bottom_px = page_sizes(width_px, height_px, is_large=is_large).bottom_px
    return lines * _LEGEND_LINE_PX, bottom_px + _GAP_PX


def scene_place_css() -> str:
    """A style that keeps the scene where the docks leave it room, for the time before they come."""
    rules = []
    for least_px in (_PHONE_PX, _WIDE_PX):
        sizes = page_sizes(least_px, FIRST_WINDOW_PX[1])
        left_px, right_px = sizes.left_px + _DOCK_EDGE_PX, sizes.right_px + _DOCK_EDGE_PX
        place = f"left: {left_px}px !important; right: {right_px}px !important;"
        rules.append(f"@media (min-width: {least_px}px) {{ {_SCENE} {{ {place} }} }}")
    return "\n".join(rules)


class PageLayout:
    """The panels of one browser's page beside viser's main one.

    ``depth``, ``similarity``, ``time``: containers to be filled.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._main = gui.main_panel
        self._depth_panel = gui.add_panel()
        self.depth = self._depth_panel.add_tab("Depth image")
        self._depth_panel.dock_left()
        self._similarity_panel = gui.add_panel()
        self.similarity = self._similarity_panel.add_tab("Where do they fit?")
        self._similarity_panel.dock_below(self._depth_panel)
        self._time_panel = gui.add_panel()
        self.time = self._time_panel.add_tab("Time and ranges")
        self._placed: PageSizes | None = None

    def arrange(self, sizes: PageSizes) -> None:
        """Place the panels; where nothing has changed, they stay where a person has put them."""
        if sizes == self._placed:
            return
        self._placed = sizes
        self._main.dock_right()
        self._main.set_width(sizes.right_px)
        self._depth_panel.set_width(sizes.left_px)
        self._time_panel.float(
            x=_GAP_PX, y=-_GAP_PX, width=sizes.between_px, height=sizes.bottom_px
        )
