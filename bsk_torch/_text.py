"""Text from others, such as names in files, where people read it: terminals, figures, pages."""

from __future__ import annotations

from unicodedata import category

HIDDEN = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode's categories of characters that move the cursor, start escape sequences, change the direction of text, or end lines."""


def visible(text: str, keep: str = "\n\t") -> str:
    r"""Return ``text`` with hidden characters as escapes, such as ``\x1b``, except those in ``keep``.

    In a terminal, hidden characters of a name could fake or hide output, or change the title of the window.
    """
    if text.isprintable():
        return text
    return "".join(c.encode("unicode_escape").decode() if c not in keep and category(c) in HIDDEN else c for c in text)
