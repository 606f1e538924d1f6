"""The exceptions that a user may see; each message says what, where, the value and the remedy."""


class MapperError(Exception):
    """Base of every error that the command line prints as one line, without a traceback."""


class InputError(MapperError):
    """An input file, folder or bag cannot be used."""


class ConfigError(MapperError):
    """A setting has an unknown name or a value out of its range."""


class OutputError(MapperError):
    """The output folder cannot be written or must not be overwritten."""


class MeasurementError(MapperError):
    """One measurement is unusable; the run goes on and counts it.

    ``reason`` is the short key that statistics count it under, for example ``empty_cloud``.
    """

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason
