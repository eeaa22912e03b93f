"""The page's parts have room on every screen."""

import pytest

from scanloom.page.layout import covered_px, page_sizes, scene_place_css


@pytest.mark.parametrize("is_large", [False, True])
@pytest.mark.parametrize("window_px", [(1600, 900), (1280, 720), (390, 844), (1920, 1080), (1, 1)])
def test_pictures_fit_their_panels(window_px: tuple[int, int], is_large: bool) -> None:
    width_px, height_px = window_px
    sizes = page_sizes(width_px, height_px, is_large=is_large)
    assert sizes.picture_px[0] >= 270
    assert sizes.picture_px[1] > 100
    assert sizes.profile_px[1] >= 100
    if width_px >= 1280:
        # The scene keeps most of the width that the window leaves it, and half of a wide one.
        assert sizes.left_px + sizes.right_px + sizes.between_px <= width_px
        assert sizes.between_px >= 0.45 * width_px
        assert sizes.picture_px[0] <= sizes.left_px
        assert sizes.profile_px[0] <= sizes.between_px
        assert 2 * sizes.bottom_px < height_px


@pytest.mark.parametrize("is_large", [False, True])
@pytest.mark.parametrize("window_px", [(1600, 900), (1280, 720), (390, 844), (1920, 1080)])
def test_much_of_the_scene_is_not_covered(window_px: tuple[int, int], is_large: bool) -> None:
    above_px, below_px = covered_px(*window_px, is_large=is_large)
    assert 0 < above_px + below_px < (0.57 if is_large else 0.56) * window_px[1]
    sizes = page_sizes(*window_px, is_large=is_large)
    assert below_px >= (sizes.bottom_px if window_px[0] >= 768 else 0)


@pytest.mark.parametrize("is_large", [False, True])
@pytest.mark.parametrize("window_px", [(1600, 900), (1280, 720), (1920, 1080)])
def test_without_depth_images_the_scene_has_their_width(
    window_px: tuple[int, int], is_large: bool
) -> None:
    full = page_sizes(*window_px, is_large=is_large)
    alone = page_sizes(*window_px, is_large=is_large, has_depth=False)
    more_px = alone.between_px - full.between_px
    # Large controls share what becomes free.
    assert more_px + alone.right_px - full.right_px == full.left_px - alone.left_px >= 60
    assert more_px > 0
    assert alone.right_px >= full.right_px
    assert alone.profile_px[0] > full.profile_px[0]
    assert alone.bottom_px == full.bottom_px


def test_the_scene_is_kept_where_the_docks_leave_it_room() -> None:
    css = scene_place_css()
    for window_px, least_px in (((1600, 900), 1400), ((1280, 720), 768)):
        sizes = page_sizes(*window_px)
        place = f"left: {sizes.left_px + 4}px !important; right: {sizes.right_px + 4}px !important;"
        assert any(
            f"(min-width: {least_px}px)" in line and place in line for line in css.splitlines()
        )
