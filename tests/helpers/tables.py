"""How the tables of a page are aligned."""

import html
import re

UNITS = r"\d[\d.]*e[+-]?\d+|\b(?:inf|nan|px|ms|s|to)\b"  # letters of numbers


def words_at_the_right(page: str) -> list[str]:
    """What the cells of tables hold that begin no row, have words in them, and are aligned as numbers are."""
    rows = re.findall(r"<tr\b.*?</tr>", re.sub(r"<thead>.*?</thead>", "", page, flags=re.S), re.S)
    cells = [cell for row in rows for cell in re.findall(r"<t[dh]\b([^>]*)>(.*?)</t[dh]>", row, re.S)[1:]]
    said = [(attributes, html.unescape(re.sub(r"<[^>]+>", " ", content))) for attributes, content in cells]
    return [text for attributes, text in said
            if re.search("[A-Za-z]", re.sub(UNITS, "", text)) and not re.search(r"""["' ](?:text|word)\b""",
                                                                                attributes)]
