"""Quick commands, commands that do not run, and commands that fail."""

import functools

from mitsvbrdf import cli

FAST = ["--method", "direct", "--renderer", "analytic", "--iterations", "3"]


def parsed_only(monkeypatch):
    """Commands do not run from here on; name and options of each are appended to what is returned."""
    called, of = [], cli.command

    def parsed(name, arguments):
        function = of(name, arguments)
        return functools.wraps(function)(lambda *given, **options: called.append((name, options)) or 0)

    monkeypatch.setattr(cli, "command", parsed)
    return called


def fails(capsys, tmp_path, arguments, *words):
    """The command exits with 2, prints one error that has these words, and leaves nothing behind."""
    before = sorted(tmp_path.rglob("*"))
    capsys.readouterr()
    assert cli.main([str(a) for a in arguments]) == 2
    message = capsys.readouterr().err
    assert message.count("error:") == 1 and "Traceback" not in message
    for word in words:
        assert word in message, message
    assert sorted(tmp_path.rglob("*")) == before
