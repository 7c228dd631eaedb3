"""The viewer as a page for a browser on this machine."""

from contextlib import suppress
from typing import Final
from urllib.parse import quote

from contact_tracker.errors import ViewerError
from contact_tracker.viewer.null_viewer import SelfClosing
from contact_tracker.viewer.sinks import HOST, PORT, Sink, address, answers, end, start, to_viewer

WEB_PORT: Final = 9090


class WebViewer(SelfClosing):
    """Serves the viewer's page at ``url`` and its data to this machine only, until it is closed.

    Parameters
    ----------
    port : for recordings.
    web_port : for the page.

    Raises
    ------
    ViewerError : it does not start, or a port is in use.
    """

    def __init__(self, port: int = PORT, web_port: int = WEB_PORT) -> None:
        for taken in (port, web_port):
            if answers(taken) is not None:
                raise ViewerError(f"port {taken} is taken: end what listens there, perhaps another viewer")
        options = ("--serve-web", "--web-viewer-port", str(web_port))
        self._server = start(port, options)
        self.url = f"http://{HOST}:{web_port}/?url={quote(address(port), safe='')}"
        self.sink: Sink = to_viewer(port)

    def wait_until_interrupted(self) -> None:
        """Serve until Ctrl-C, or until the server ends."""
        with suppress(KeyboardInterrupt):
            self._server.wait()

    def close(self) -> None:
        """End the server."""
        end(self._server)
