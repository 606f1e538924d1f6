"""Draw what Rerun shows, without a screen.

    python docs/tools/rerun_pictures.py RECORDING.rrd PICTURE.png [WINDOW]
    python docs/tools/rerun_pictures.py --live PICTURE.png SECONDS incremental_mapper map ... --view

The time is set to WINDOW, or to the end; live, the picture is taken after so many SECONDS of the
command. Needs rerun-sdk 0.41 or later, and Vulkan, of which there is one without a graphics card
(``apt-get install mesa-vulkan-drivers``).
"""

import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

SIZE = '1400x800'
PORT = 9876
"""Rerun's own: a command with --view sends to the viewer that is there."""
START, DRAW = 4.0, 6.0
"""Seconds until the viewer answers, and until it has drawn what was opened."""
COLOURS = 96


@contextmanager
def viewer(*recording: str) -> Iterator[None]:
    """Run a viewer while the block runs.

    Args:
        recording: What it opens, if anything.
    """
    words = ['rerun', *recording, '--headless', '--window-size', SIZE, '--port', str(PORT)]
    silent = subprocess.DEVNULL
    shown = subprocess.Popen(words, stdout=silent, stderr=silent, start_new_session=True)
    try:
        time.sleep(START)
        yield
    finally:
        os.killpg(shown.pid, signal.SIGTERM)  # what is called is a script around the viewer
        shown.wait()


def save(client: ViewerClient, picture: Path) -> None:
    """Save what a viewer shows as a small PNG."""
    shown = Image.open(io.BytesIO(client.take_screenshot())).convert('RGB')
    shown.quantize(COLOURS).save(picture, optimize=True)
    print(picture)


def client() -> ViewerClient:
    """Somebody who may ask the viewer."""
    return ViewerClient.connect(f'rerun+http://127.0.0.1:{PORT}/proxy')


def main() -> None:
    """Draw what the arguments name."""
    words = sys.argv[1:]
    if words[:1] == ['--live'] and len(words) > 3:
        with viewer(), subprocess.Popen(words[3:]):
            time.sleep(float(words[2]))
            save(client(), Path(words[1]))
    elif len(words) in (2, 3):
        with viewer(str(Path(words[0]).absolute())):
            asked = client()
            if len(words) == 3:
                asked.set_time('window', sequence=int(words[2]), play_state='paused')
            time.sleep(DRAW)
            save(asked, Path(words[1]))
    else:
        sys.exit(__doc__)


if __name__ == '__main__':
    main()
