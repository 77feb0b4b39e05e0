"""Elements of a page; what is text is escaped when the page is written."""

from __future__ import annotations

from xml.etree import ElementTree as ET


def add(parent: ET.Element, tag: str, text: str = "", **attributes: str) -> ET.Element:
    """Add an element with a text; ``class_`` stands for ``class``, ``a_b`` for ``a-b``."""
    names = {key.rstrip("_").replace("_", "-"): value for key, value in attributes.items()}
    element = ET.SubElement(parent, tag, names)
    element.text = text
    return element


def add_table(
    parent: ET.Element, label: str, heads: list[str], rows: list[list[str]]
) -> ET.Element:
    """Add a table that scrolls by itself where it is wide; its first column names the rows.

    Args:
        parent: where to add it.
        label: what it is, for screen readers.
        heads: titles of the columns.
        rows: their cells.
    """
    box = add(parent, "div", class_="scroll", tabindex="0", role="region", aria_label=label)
    table = add(box, "table")
    head = add(add(table, "thead"), "tr")
    for name in heads:
        add(head, "th", name, scope="col")
    body = add(table, "tbody")
    for cells in rows:
        row = add(body, "tr")
        add(row, "th", cells[0], scope="row")
        for cell in cells[1:]:
            add(row, "td", cell, class_="number")
    return body
