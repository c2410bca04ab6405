"""`factory completion`: prints the completion script of a shell."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from factory.cli import main


@click.command("completion")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def command(shell: str) -> None:
    """Print the completion script of a shell.

    \b
    bash:  factory completion bash >> ~/.bashrc
    zsh:   factory completion zsh >> ~/.zshrc
    fish:  factory completion fish > ~/.config/fish/completions/factory.fish
    """
    script = get_completion_class(shell)
    if script is not None:
        click.echo(script(main.cli, {}, "factory", "_FACTORY_COMPLETE").source())
