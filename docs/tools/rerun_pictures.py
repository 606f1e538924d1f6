"""Draw what Rerun shows of a recording, without a screen.

    python docs/tools/rerun_pictures.py RECORDING.rrd PICTURE.png [WINDOW]

The time is set to WINDOW, or to the end. Needs rerun-sdk 0.41 or later, and Vulkan, of which there
is one without a graphics card (``apt-get install mesa-vulkan-drivers``).
"""

import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

SIZE = '1400x800'
PORT = 9917
START, DRAW = 4.0, 6.0
"""Seconds until the viewer answers, and until it has drawn what was opened."""
COLOURS = 200


def draw(recording: Path, picture: Path, window: int | None) -> None:
    """Open a recording in a viewer of its own, and save what it shows.

    Args:
        recording: A file of ``--rrd`` or ``view --save``.
        picture: PNG that is written.
        window: Where in the drive; None is its end.
    """
    words = ['rerun', str(recording.absolute()), '--headless', '--window-size', SIZE]
    silent = subprocess.DEVNULL
    viewer = subprocess.Popen(
        [*words, '--port', str(PORT)], stdout=silent, stderr=silent, start_new_session=True
    )
    try:
        time.sleep(START)
        client = ViewerClient.connect(f'rerun+http://127.0.0.1:{PORT}/proxy')
        if window is not None:
            client.set_time('window', sequence=window, play_state='paused')
        time.sleep(DRAW)
        shown = Image.open(io.BytesIO(client.take_screenshot())).convert('RGB')
    finally:
        os.killpg(viewer.pid, signal.SIGTERM)  # what is called is a script around the viewer
        viewer.wait()
    shown.quantize(COLOURS).save(picture, optimize=True)


def main() -> None:
    """Draw what the arguments name."""
    words = sys.argv[1:]
    if len(words) not in (2, 3):
        sys.exit(__doc__)
    draw(Path(words[0]), Path(words[1]), int(words[2]) if len(words) == 3 else None)
    print(words[1])


if __name__ == '__main__':
    main()
