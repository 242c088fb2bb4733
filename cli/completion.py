"""`pamid completion`: Print what your shell needs to complete pamid's commands."""

from __future__ import annotations

import click

from . import frame

HELP_ORDER = 180
EXAMPLE = """
pamid completion bash
"""
_STARTUP = {
    "bash": ('eval "$(pamid completion bash)"', "~/.bashrc"),
    "zsh": ('eval "$(pamid completion zsh)"', "~/.zshrc"),
    "fish": ("pamid completion fish | source", "~/.config/fish/config.fish"),
}


@frame.command("completion", example=EXAMPLE)
@click.argument("shell", type=click.Choice(list(_STARTUP)))
def command(shell: str) -> frame.Result:
    """Print the completion script of a shell. To have it always:

    \b
        bash    eval "$(pamid completion bash)"        in ~/.bashrc
        zsh     eval "$(pamid completion zsh)"         in ~/.zshrc
        fish    pamid completion fish | source         in ~/.config/fish/config.fish
    """
    from click.shell_completion import get_completion_class

    completion = get_completion_class(shell)
    assert completion is not None
    script = completion(frame.group(), {}, "pamid", "_PAMID_COMPLETE").source()
    line, place = _STARTUP[shell]
    return frame.Result(
        {
            "schema": "pamid.completion/1",
            "shell": shell,
            "script": script,
            "line": line,
            "place": place,
        },
        script,
    )
