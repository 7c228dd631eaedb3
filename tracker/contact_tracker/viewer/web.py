"""The viewer as a page for a browser on this machine."""

from contextlib import suppress
from types import TracebackType
from typing import Final, Self
from urllib.parse import quote

from contact_tracker.errors import ViewerError
from contact_tracker.viewer.sinks import HOST, PORT, Sink, address, answers, end, start, to_viewer

WEB_PORT: Final = 9090


class WebViewer:
    """Serves the page at ``url`` and what is shown on it, until it is closed; only this machine reaches it.

    Parameters
    ----------
    port : at which it takes recordings.
    web_port : of the page.

    Raises
    ------
    ViewerError : it does not start, or something listens at one of the ports.
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
        """Serve until Ctrl-C, or until it is ended from elsewhere."""
        with suppress(KeyboardInterrupt):
            self._server.wait()

    def close(self) -> None:
        """End it."""
        end(self._server)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
