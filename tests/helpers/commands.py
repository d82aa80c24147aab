"""Quick commands, and commands that fail."""

from mitsvbrdf import cli

FAST = ["--method", "direct", "--renderer", "analytic", "--iterations", "3"]


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
