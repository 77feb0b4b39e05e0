"""Hook of MkDocs: the reference page, made from the sources, so that it cannot be out of date."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from pipeline_tracker.replay.estimates import COLUMNS
from pipeline_tracker.resources import config_path, message_directory
from pipeline_tracker.settings_io import settings_table

_PAGE = "reference.md"
_SHARED = ("/parameter_events", "/rosout", "~/transition_event")


def topics_table() -> str:
    """Return what each node opens, by the least-privilege policy, which tests hold to the nodes."""
    lines = ["| node | subscribes | publishes | services |", "|---|---|---|---|"]
    policy = ET.parse(config_path("sros2/policy.xml"))  # noqa: S314 - our own file
    enclave = policy.find("enclaves/enclave")
    if enclave is None:
        raise ValueError("config/sros2/policy.xml has no enclave")
    profiles = list(enclave.iter("profile"))
    services = [{str(s.text) for s in p.findall("services/service")} for p in profiles]
    shared = set.intersection(*services).union(_SHARED)
    for profile in profiles:
        cells = [f"`{profile.get('node')}`"]
        for path in ("topics[@subscribe]/topic", "topics[@publish]/topic", "services/service"):
            names = [str(found.text) for found in profile.findall(path)]
            shown = [name for name in names if name not in shared and "parameter" not in name]
            cells.append(", ".join(f"`{name}`" for name in shown))
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def messages_text() -> str:
    """Return the definitions of the messages as they are, comments included."""
    parts = []
    for file in sorted(message_directory().glob("*.msg")):
        text = file.read_text(encoding="utf-8").rstrip()
        parts.append(f"### {file.stem}\n\n```text\n{text}\n```\n")
    return "\n".join(parts)


def columns_table() -> str:
    """Return the columns of estimates.csv."""
    lines = ["| column | unit | meaning |", "|---|---|---|"]
    lines += [f"| `{name}` | {unit} | {meaning} |" for name, (unit, meaning) in COLUMNS.items()]
    return "\n".join(lines)


def reference_page() -> str:
    """Return the whole page."""
    return f"""# Topics, messages, settings, columns

Made from the sources when this site is built.

## Topics

Names are relative: namespaces and remapping work. Every node has the services of a managed node and those of parameters, and publishes `/rosout`; they are left out here.

{topics_table()}

## Messages

{messages_text()}
## Settings

In a YAML file (`--config`), as ROS parameters of the same dotted names, or with `--set key=value`.

{settings_table()}
## estimates.csv

One row for each left image, in time order, none left out. What is not known is an empty cell.

{columns_table()}
"""


def on_files(files: Any, config: Any) -> Any:
    """Add the page."""
    from mkdocs.structure.files import File  # noqa: PLC0415 - only where a site is built

    files.append(File.generated(config, _PAGE, content=reference_page()))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Lead links to files of the repository to their names, which are no pages."""
    del config, files
    here = Path(page.file.src_path)

    def named(link: re.Match[str]) -> str:
        text, target = link[1], link[2]
        return text if target.startswith("../") and here.parts else link[0]

    return re.sub(r"\[([^\]]+)\]\(([^)]+)\)", named, markdown)
