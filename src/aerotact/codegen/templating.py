"""The C templates."""

import jinja2


def templates() -> jinja2.Environment:
    """Environment of the C templates; an undefined name is an error."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader("aerotact.codegen"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
