"""Model -> law: one paper, one module. A module offers its laws in a constant `LAWS`: block name -> builder."""

from aerotact.discovery import BlockMaker, collect

LawBuilder = BlockMaker


def laws() -> dict[str, LawBuilder]:
    """Every law by its block's name."""
    return collect(__name__, "LAWS")
