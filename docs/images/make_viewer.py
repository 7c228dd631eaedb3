"""Remakes docs/images/viewer.png: ``python docs/images/make_viewer.py``, without a screen or a GPU.

It needs a Vulkan driver; that of software is enough (on Debian: ``apt-get install mesa-vulkan-drivers``).
``--help`` says what other pictures it makes.
"""

import argparse
import os
import socket
import subprocess
import sys
import tempfile
import time
from io import BytesIO
from pathlib import Path

import numpy as np
import rerun_cli
from PIL import Image
from rerun.experimental import ViewerClient

from contact_tracker.cli.main import run

ROOT = Path(__file__).resolve().parents[2]
SETTLE_S = 3.0
START_S = 60.0
MENU_PX = 37


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--log", default=str(ROOT / "recordings/paper_experiment.mcap"))
    parser.add_argument("--at", type=float, default=20.0, metavar="S", help="seconds after the first pose")
    parser.add_argument("--size", default="1600x900", metavar="WxH")
    parser.add_argument("--output", type=Path, default=ROOT / "docs/images/viewer.png")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.rrd"
        code = run(["view", args.log, "--save", str(path), "-q"])
        if code:
            sys.exit(code)
        args.output.write_bytes(picture(path, args.at, args.size, folder))


def picture(path: Path, at_s: float, size: str, home: str) -> bytes:
    """A PNG of the viewer with its time cursor ``at_s``; its settings are in ``home``."""
    port = free_port()
    program = Path(rerun_cli.__file__).parent / "rerun"
    options = ["--headless", "--hide-welcome-screen", "--bind", "127.0.0.1", "--window-size", size]
    environment = {k: v for k, v in os.environ.items() if k not in {"DISPLAY", "WAYLAND_DISPLAY", "RUST_LOG"}}
    environment |= {"HOME": home, "XDG_CONFIG_HOME": home, "CI": "true", "WGPU_BACKEND": "vulkan"}
    viewer = subprocess.Popen(
        [program, *options, "--port", str(port)],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        client = connected(viewer, port)
        client.open([str(path)])
        state = client.get_state()
        end = time.monotonic() + START_S
        while state.loading or not any(recording.timelines for recording in state.recordings):
            if time.monotonic() > end:
                sys.exit("the viewer does not load the recording")
            time.sleep(0.2)
            state = client.get_state()
        client.set_time("t", play_state="paused", duration=np.timedelta64(round(at_s * 1e9), "ns"))
        client.take_screenshot(max_size=64)  # has every view run once
        time.sleep(SETTLE_S)
        return without_menu(bytes(client.take_screenshot()))
    finally:
        viewer.kill()
        viewer.wait()


def without_menu(png: bytes) -> bytes:
    """Without the bar at the top, which tells of the machine that drew it."""
    cut = BytesIO()
    with Image.open(BytesIO(png)) as whole:
        shown = whole.crop((0, MENU_PX, whole.width, whole.height)).convert("RGB")
        shown.quantize(256, dither=Image.Dither.NONE).save(cut, "PNG", optimize=True)
    return cut.getvalue()


def connected(viewer: "subprocess.Popen[bytes]", port: int) -> ViewerClient:
    end = time.monotonic() + START_S
    while viewer.poll() is None and time.monotonic() < end:
        try:
            socket.create_connection(("127.0.0.1", port), 1).close()
            time.sleep(SETTLE_S)
            return ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
        except OSError:
            time.sleep(0.2)
    sys.exit("the viewer does not start: is there a Vulkan driver (mesa-vulkan-drivers)?")


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


if __name__ == "__main__":
    main()
