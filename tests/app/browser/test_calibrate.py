"""The Calibrate step: a person turns the camera, sees it, takes it back, and saves it."""

from pathlib import Path

import numpy as np
from playwright.sync_api import expect

from fusion_core.recordings.calibration_files.extrinsics import read_extrinsics
from tests.app.browser.person import Person


def test_the_camera_is_turned_by_keys_seen_undone_and_saved(
    person: Person, output_root: Path
) -> None:
    person.key("Alt+7")
    person.wait_for_panel("Calibrate")
    verdict = person.page.locator(".scanloom-verdict")
    expect(verdict).to_contain_text("lie on what the camera sees")
    person.wait_until(lambda: person.frame_view.calibration is not None)
    first = person.figure()
    calibration = person.frame_view.calibration
    assert calibration is not None
    begin = calibration.now.pose
    depth = person.picture("depth")
    # By the keys of the number's field, in the step that was chosen.
    person.choose("Step", "coarse: 1°, 5 cm")
    yaw = person.page.get_by_label("Yaw (°)", exact=True)
    yaw.click()

    def turn_deg() -> float:
        """How far one press of the key turns it."""
        before_deg = person.number("Yaw (°)")
        yaw.press("ArrowUp")
        person.wait_until(lambda: person.number("Yaw (°)") != before_deg)
        return person.number("Yaw (°)") - before_deg

    # The page does not show when it has heard of the step: until then a press turns it by less.
    assert any(turn_deg() > 0.9 for _ in range(50))
    for _ in range(3):
        assert abs(turn_deg() - 1.0) < 0.01
    turned_deg = person.number("Yaw (°)")
    person.wait_until(lambda: person.frame_view.view.hand_pose is not None)
    expect(verdict).to_contain_text("Before:")
    person.wait_until(lambda: not np.array_equal(person.figure(), first))
    # What stands beside it follows, and every step says why.
    depth = person.wait_for_another_picture("depth", depth)
    expect(person.text("Camera set by hand: yaw")).to_be_visible()
    # The keys of a field are its own. Slow presses are several changes.
    person.page.locator(".scanloom-verdict h2").click()
    turns = 0
    while person.session.view.extrinsics is not None:
        person.change_by_key("Control+z")
        turns += 1
    person.wait_for_figure(first[..., ::-1])
    person.wait_for_number("Yaw (°)", begin.yaw_deg, within=0.006)
    for _ in range(turns):
        person.change_by_key("Control+Shift+z")
    assert person.session.view.hand_pose is not None
    # What is saved is what is shown.
    person.wait_for_number("Yaw (°)", turned_deg, within=0.006)
    person.wait_until(lambda: person.frame_view.view.hand_pose is not None)
    person.press("Save as file")
    person.wait_until(lambda: len(list(output_root.rglob("extrinsics.json"))) == 1)
    (file,) = output_root.rglob("extrinsics.json")
    pose = person.session.view.hand_pose
    assert pose is not None
    boxes = person.page.locator("textarea", has_text=str(file)).locator("visible=true")
    expect(boxes.first).to_be_visible()
    (T_camera_lidar,) = read_extrinsics(file).values()
    np.testing.assert_allclose(np.linalg.inv(T_camera_lidar), pose.T_lidar_camera, atol=1e-9)
