"""What every part of the page has at hand."""

from __future__ import annotations

from dataclasses import dataclass, field

import viser

from gpdf_service.viewer.body import Body
from gpdf_service.viewer.frame import Frame
from gpdf_service.viewer.link import Link
from gpdf_service.viewer.panel import Panel
from gpdf_service.viewer.worker import Worker


@dataclass(frozen=True, slots=True)
class Desk:
    """Slow work runs on two workers, so that plans do not wait for maps.

    Attributes:
        browser: Who sees the page.
        panel: The widgets.
        link: The service.
        maps: Does what concerns scenes and layers.
        plans: Does what concerns plans and logs.
        frame: Where the page's zero is.
    """

    browser: viser.ClientHandle
    panel: Panel
    link: Link
    maps: Worker
    plans: Worker
    frame: Frame = field(default_factory=Frame)

    @property
    def body(self) -> Body:
        """The body that is planned for."""
        return self.panel.plan.body
