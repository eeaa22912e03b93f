"""A day's work by the keyboard alone: no mouse, no touch, and nothing done behind the page."""

from pathlib import Path

from playwright.sync_api import expect

from scanloom.scene.frame_summary import conflict_runs
from tests.app.browser.person import Person

# More controls than a page has.
_MOST_TABS = 120


def tab_to(person: Person, condition: str, *, backwards: bool = False) -> None:
    """Press Tab until the focused element meets a condition in JavaScript, of ``it``."""
    is_there = f"() => [...document.querySelectorAll('*')].some(it => {condition})"
    person.wait_until(lambda: bool(person.page.evaluate(is_there)))
    key = "Shift+Tab" if backwards else "Tab"
    for _ in range(_MOST_TABS):
        if person.page.evaluate(f"(it => Boolean({condition}))(document.activeElement)"):
            return
        person.page.keyboard.press(key)
    raise AssertionError(f"Tab does not reach {condition}")


def is_slider(label: str) -> str:
    """The thumb of a slider, by the label beside it."""
    return (
        "it.getAttribute('role') === 'slider' && "
        "[...document.querySelectorAll('label')].some(label => "
        f"label.textContent.trim() === '{label}' && label.offsetParent && "
        "document.getElementById(label.htmlFor)?.contains(it))"
    )


def is_button(name: str) -> str:
    return f"it.tagName === 'BUTTON' && it.textContent.trim() === '{name}'"


def open_by_keyboard(person: Person, recording: Path) -> None:
    """From the page to the dialog, and back with the recording aligned."""
    person.page.keyboard.press("o")
    # The dialog has the focus as soon as it is open, so Tab goes through it alone.
    expect(person.page.locator(".scanloom-files").get_by_text(recording.name)).to_be_visible()
    tab_to(person, f"it.closest('.scanloom-files') && it.textContent.includes('{recording.name}')")
    person.page.keyboard.press("Enter")
    person.wait_until(
        lambda: (
            person.frame_view.view.recording == recording.name
            and person.frame_view.chain is not None
        )
    )
    expect(person.page.get_by_role("dialog")).to_have_count(0)


def wait_until_counted(person: Person) -> None:
    """Wait until noise is counted in all frames, with the settings of the view."""
    # Until it is on the page, it is not said that frames are being counted anew.
    person.wait_until_on_page()
    expect(person.page.get_by_text("counting noise")).to_have_count(0)


def test_the_whole_way_by_keyboard(
    person: Person, small_scene: Path, damaged: Path, output_root: Path
) -> None:
    keyboard, session = person.page.keyboard, person.session
    known = set(output_root.rglob("*"))

    open_by_keyboard(person, damaged)
    open_by_keyboard(person, small_scene)

    # Open the step, and the frame with the most noise.
    keyboard.press("Alt+4")
    person.wait_for_panel("Repair")
    wait_until_counted(person)
    keyboard.press("Home")
    person.wait_until(lambda: person.frame_view.view.frame_index == 0)
    keyboard.press("m")
    person.wait_until(lambda: person.frame_view.view.frame_index > 0)
    worst = session.view.frame_index

    # Change the tolerance.
    before = session.view.settings.noise.epsilon
    tab_to(person, is_slider("ε (σ)"))
    for _ in range(3):
        keyboard.press("ArrowRight")
    person.wait_until(lambda: session.view.settings.noise.epsilon > before + 0.25)
    assert session.view.frame_index == worst

    # See why: the next conflict, and what is said of its beam.
    wait_until_counted(person)
    keyboard.press("n")
    person.wait_until(lambda: person.frame_view.view.selected_beam is not None)
    shown = person.frame_view
    assert shown.fused is not None
    assert session.view.selected_beam == conflict_runs(shown.fused)[0].middle
    expect(person.text(f"beam {session.view.selected_beam}, range")).to_be_visible()

    # Undo: back to the step, and to the setting; arrows pressed in a row are one drag.
    keyboard.press("Alt+2")
    person.wait_for_panel("Match")
    keyboard.press("Control+z")
    person.wait_for_panel("Repair")
    assert session.view.settings.noise.epsilon > before
    while session.view.settings.noise.epsilon != before:
        person.change_by_key("Control+z")
    assert session.view.frame_index == worst

    # Build the map, without figures, and export it.
    keyboard.press("Alt+6")
    person.wait_for_panel("Map")
    tab_to(person, "it.type === 'checkbox' && it.labels?.[0]?.textContent.includes('Figures')")
    keyboard.press("Space")
    tab_to(person, is_button("Build"))
    keyboard.press("Enter")
    expect(person.button("Download .zip")).to_be_visible()
    tab_to(person, is_button("Export clouds (PLY, PCD)"))
    keyboard.press("Enter")
    expect(person.text("Clouds: lidar")).to_be_visible()
    written = {path.name for path in set(output_root.rglob("*")) - known}
    assert {"alignment.json", "lidar.ply", "depth.ply"} <= written
