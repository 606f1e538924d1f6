"""Headers of messages as they lie in a bag: read and replaced without decoding the rest."""

import struct

from incremental_mapper.measurements import NANOSECONDS


def stamped(data: bytes, stamp: int, ros1: bool) -> bytes:
    """A message as it lies in a bag, with another header stamp (ns)."""
    order = '<' if ros1 or data[1:2] in (b'\x01', b'\x03') else '>'
    time = struct.pack(f'{order}iI', *divmod(stamp, NANOSECONDS))
    return data[:4] + time + data[12:]


def peek_header(data: bytes, ros1: bool) -> tuple[int, str]:
    """Read stamp (ns) and frame_id of a message that begins with a header, as it lies in a bag.

    Raises:
        struct.error: it is too short.
        UnicodeDecodeError: the frame_id is no text.
    """
    # ROS 1 has a number before the stamp, CDR four bytes of which the second tells the order.
    order = '<' if ros1 or data[1:2] in (b'\x01', b'\x03') else '>'
    seconds, nanoseconds, length = struct.unpack_from(f'{order}iII', data, 4)
    frame = bytes(data[16 : 16 + length]).rstrip(b'\0').decode()
    return seconds * NANOSECONDS + nanoseconds, frame
