"""Command groups: suggestions for misspelled names, and groups with a default command."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import click
from click.shell_completion import CompletionItem

from schemas.support.suggest import did_you_mean

_MOST = 2
"""Maximum number of suggested names."""


class CommandGroup(click.Group):
    """A group that lists its commands in order of definition and suggests names for a misspelled one."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """Returns the names of the commands."""
        return list(self.commands)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Returns the command that the first argument names.

        Raises:
            click.UsageError: the command does not exist.
        """
        name = str(args[0])
        names = self.list_commands(ctx)
        if name not in names and not name.startswith("-") and not ctx.resilient_parsing:
            ctx.fail(f"No such command {name!r}{did_you_mean(name, names, _MOST)}")
        return super().resolve_command(ctx, args)


class _GroupContext(click.Context):
    """The context of a default command; usage and errors show the path of its group."""

    @property
    def command_path(self) -> str:
        """The path of the group."""
        return self.parent.command_path if self.parent is not None else super().command_path


class DefaultCommand(click.Command):
    """The default command of a `DefaultGroup`."""

    context_class = _GroupContext


class DefaultGroup(CommandGroup):
    """A group with a default command, which runs when the first argument names no other command.

    Its help shows the options of the default command and the list of the others.
    """

    default: click.Command

    def set_default(self, command: DefaultCommand) -> None:
        """Adds the default command."""
        self.default = command
        self.add_command(command)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Inserts the name of the default command if the first argument is not a command."""
        first = args[0] if args else None
        if first is None and ctx.resilient_parsing:
            return super().parse_args(ctx, args)
        if first not in self.commands and first not in self.get_help_option_names(ctx):
            args = [str(self.default.name), *args]
        return super().parse_args(ctx, args)

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Writes the help of the default command, then the other commands."""
        self.default.format_help(ctx, formatter)
        self.format_commands(ctx, formatter)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Returns the commands, and the completions of the default command's first argument."""
        items = super().shell_complete(ctx, incomplete)
        context = self.default.make_context(ctx.info_name, [], ctx.parent, resilient_parsing=True)
        items.extend(item for item in self.default.shell_complete(context, incomplete) if item not in items)
        first = next((p for p in self.default.params if isinstance(p, click.Argument)), None)
        if first is not None and not incomplete.startswith("-"):
            items.extend(first.shell_complete(context, incomplete))
        return items


def no_option_error(error: click.NoSuchOption) -> click.UsageError:
    """Returns the error for an unknown option, with suggestions of visible options of the command."""
    known = _visible_options(error.ctx.command.params if error.ctx is not None else ())
    return click.UsageError(
        f"No such option {error.option_name!r}{did_you_mean(error.option_name, known, _MOST)}", ctx=error.ctx
    )


def _visible_options(params: Sequence[Any]) -> Iterator[str]:
    for param in params:
        if isinstance(param, click.Option) and not param.hidden:
            yield from (*param.opts, *param.secondary_opts)
