"""The page of a fit, read as a browser reads it, and settings of a quick fit."""

import base64
import io
import re
from html.parser import HTMLParser

import numpy as np
import PIL.Image

SIDE = 32
FAST = ["--method", "direct", "--renderer", "analytic", "--iterations", "12", "--resolution", str(SIDE)]
HOSTILE = "a&b <img src=x onerror=alert(1)>"


class Page(HTMLParser):
    """Text, pictures by their alt text, and tables row by row; every tag is closed, no id stands twice."""

    VOID = ("img", "meta", "link", "br", "input")

    def __init__(self, path):
        super().__init__()
        self.source = path.read_text(encoding="utf-8")
        self.pictures, self.rows, self.addresses, self.open, self.texts, self.ids = {}, [], [], [], [], []
        self.feed(self.source)
        assert not self.open, self.open
        assert len(set(self.ids)) == len(self.ids), sorted(self.ids)
        self.text = re.sub(r"\s+", " ", " ".join(self.texts))

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.ids += [attributes["id"]] if "id" in attributes else []
        self.addresses += [attributes[name] for name in ("src", "href", "srcset", "data", "action")
                           if name in attributes]
        if tag == "img" and "src" in attributes:
            self.pictures[attributes["alt"]] = attributes["src"]
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.texts.append(data)
        if self.rows and {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data

    def pixels(self, alt):
        head, data = self.pictures[alt].split(",", 1)
        assert head in ("data:image/png;base64", "data:image/jpeg;base64")
        return np.asarray(PIL.Image.open(io.BytesIO(base64.b64decode(data, validate=True))).convert("RGB"))

    def row(self, name):
        return next(row[1:] for row in self.rows if row and row[0].strip() == name)
