"""A terminal that keeps what was drawn."""

import io
import re

# Control sequences of ECMA-48: colors, movements and the cursor's visibility.
_CONTROL_SEQUENCE = re.compile(r"\x1b\[[?0-9;]*[A-Za-z]")
_ERASE = re.compile(r"\x1b\[[02]?K")


class CapturedTerminal(io.StringIO):
    """A terminal that keeps what was drawn."""

    def isatty(self) -> bool:
        """Whether it is a terminal: it is."""
        return True

    @property
    def drawn(self) -> list[str]:
        """Texts between two erasures of the line, without colors; repeated texts once."""
        pieces = _ERASE.split(self.getvalue())
        texts = [_CONTROL_SEQUENCE.sub("", piece).strip() for piece in pieces]
        return [text for text, before in zip(texts, [None, *texts], strict=False) if text != before]
