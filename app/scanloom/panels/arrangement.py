"""The page's parts placed and sized for the browser's window."""

from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.bridge import PageBridge
from scanloom.page.events import Screen
from scanloom.page.layout import PageLayout, PageSizes, page_sizes
from scanloom.page_parts import Panel
from scanloom.panels.pictures import DepthImagePanel, SimilarityPanel
from scanloom.panels.profile import ProfilePanel
from scanloom.panels.timeline import TimelinePanel


class ArrangementPanel(Panel):
    """Arranges the layout and sizes its pictures; first of the panels, since they draw to size."""

    def __init__(
        self,
        bridge: PageBridge,
        session: ClientSession,
        layout: PageLayout,
        pictures: tuple[DepthImagePanel, SimilarityPanel],
        timeline: TimelinePanel,
        profile: ProfilePanel,
    ) -> None:
        self._session = session
        self._layout, self._pictures = layout, pictures
        self._timeline, self._profile = timeline, profile
        self._sizes: PageSizes | None = None
        self._has_depth = True
        self._arrange(is_large=session.view.large_text)
        bridge.on_screen(self._on_screen)

    def show(self, frame_view: FrameView) -> None:
        """Size the page for the window, the view's size of letters, and what there is to see."""
        self._has_depth = frame_view.open_recording.opened.session is not None
        self._arrange(is_large=frame_view.view.large_text)

    def _on_screen(self, screen: Screen) -> None:
        self._session.window_px = screen.width_px, screen.height_px
        self._arrange(is_large=self._session.view.large_text)
        self._session.set_prefers_dark(screen.prefers_dark)
        self._session.refresh()

    def _arrange(self, *, is_large: bool) -> None:
        sizes = page_sizes(*self._session.window_px, is_large=is_large, has_depth=self._has_depth)
        if sizes == self._sizes:
            return
        self._sizes = sizes
        self._layout.arrange(sizes)
        for picture in self._pictures:
            picture.set_size(*sizes.picture_px)
        self._profile.set_size(*sizes.profile_px)
        self._timeline.set_width(sizes.profile_px[0])
