"""A frame_id as a line of text has room for it."""

_SHOWN = 40
"""Characters that are shown; a broken message may have thousands."""


def shown_frame(frame: str) -> str:
    """A frame_id in quotes, its beginning where it is long."""
    if len(frame) > _SHOWN:
        frame = f'{frame[:_SHOWN]}...'
    return repr(frame or '(none)')
