"""`pamid completion`: Print a script with which your shell completes pamid's commands."""

from __future__ import annotations

from dataclasses import dataclass

from pamid.api.options.record import argument

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


@dataclass(frozen=True)
class Arguments:
    """Print the completion script of a shell. To have it always:

    \b
        bash    eval "$(pamid completion bash)"        in ~/.bashrc
        zsh     eval "$(pamid completion zsh)"         in ~/.zshrc
        fish    pamid completion fish | source         in ~/.config/fish/config.fish
    """

    shell: str = argument(choices=tuple(_STARTUP))


@frame.command("completion", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from click.shell_completion import get_completion_class

    completion = get_completion_class(arguments.shell)
    assert completion is not None
    script = completion(frame.GROUP, {}, "pamid", "_PAMID_COMPLETE").source()
    line, place = _STARTUP[arguments.shell]
    return frame.Result(
        {
            "schema": "pamid.completion/1",
            "shell": arguments.shell,
            "script": script,
            "line": line,
            "place": place,
        },
        script,
    )
