"""The command line: a module a command; each reads its arguments and calls the rooms below."""
