"""Journals: what is kept on disk of a map while it is made, and the map that comes of it again.

A journal is one file, written from its beginning to its end (``record_file``). ``journal_writer``
puts a record into it for every window, and the points of the scans; ``recovery`` makes of them what
the mapper would have given back. Nothing in a journal is executed when it is read.
"""
