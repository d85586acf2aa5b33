"""Metadata of a dataset in the format Croissant 1.0 of MLCommons, https://docs.mlcommons.org/croissant, with its RAI 1.0."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bsk_torch.lab.offline.layout import CARD, TABLE

OWN = (
    "citeAs", "column", "equivalentProperty", "extract", "field", "fileObject", "fileProperty", "fileSet", "format", "includes",
    "isLiveDataset", "jsonPath", "key", "md5", "parentField", "path", "recordSet", "references", "regex", "repeated", "replace",
    "samplingRate", "separator", "source", "subField", "transform",
)  # fmt: skip
"""Names that Croissant 1.0 defines itself."""

CONTEXT: dict[str, object] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
    **{name: f"cr:{name}" for name in OWN},
}
"""Names of Croissant 1.0, as its specification lists them."""

KINDS = {".csv": "text/csv", ".json": "application/json", ".memmap": "application/octet-stream", ".hdf5": "application/x-hdf5"}
"""Media types of files."""

COLUMNS = {
    "behavior": ("sc:Text", "Policy that acts"),
    "episode": ("sc:Integer", "Number of the episode"),
    "seed": ("sc:Integer", "Seed that starts the episode"),
    "decisions": ("sc:Integer", "Number of decisions"),
    "seconds": ("sc:Float", "Length, s"),
    "return": ("sc:Float", "Sum of the rewards"),
}
"""Columns of the table of episodes, with types and meanings."""


def croissant(card: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the metadata of a dataset as JSON-LD.

    License, authors, address and date of publication belong to whoever publishes the dataset, and are to be added then.

    Args:
        card: Content of ``dataset.json``.
        path: That file.
    """
    behaviors = ", ".join(card["behaviors"])
    targets = ", ".join(card["targets"]) or "none"
    files = {CARD: hashlib.sha256(path.read_bytes()).hexdigest(), **card["files"]}
    return {
        "@context": dict(sorted(CONTEXT.items())),
        "@type": "sc:Dataset",
        "conformsTo": ["http://mlcommons.org/croissant/1.0", "http://mlcommons.org/croissant/RAI/1.0"],
        "name": f"bsk_torch-{card['preset']}",
        "version": f"{card['format']}.0.0",
        "description": (
            f"Simulated episodes of spacecraft tasking: the preset {card['preset']} of bsk_torch {card['bsk_torch']}, with the "
            f"behavior policies {behaviors}. Returns of all legal actions at a sample of decisions, followed by: {targets}. "
            "Binary files are memory-mapped tensordicts; meta.json next to them has shapes and types."
        ),
        "keywords": ["offline reinforcement learning", "off-policy evaluation", "spacecraft"],
        "rai:dataCollection": "Simulation; no measurement, no person. The seed of every episode is in episodes.csv.",
        "rai:dataCollectionType": "Simulations",
        "rai:dataLimitations": (
            "Scenarios are drawn by the preset; they describe no real mission. Returns of actions are those of one future "
            "for each of them unless futures is a number in dataset.json."
        ),
        "distribution": [_file(name, digest) for name, digest in sorted(files.items())],
        "recordSet": [_episodes()],
    }


def _file(name: str, digest: str) -> dict[str, object]:
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "contentUrl": name,
        "encodingFormat": KINDS[Path(name).suffix],
        "sha256": digest,
    }


def _episodes() -> dict[str, object]:
    return {
        "@type": "cr:RecordSet",
        "@id": "episodes",
        "name": "episodes",
        "description": "One row for each episode",
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"episodes/{name}",
                "name": f"episodes/{name}",
                "description": meaning,
                "dataType": kind,
                "source": {"fileObject": {"@id": TABLE}, "extract": {"column": name}},
            }
            for name, (kind, meaning) in COLUMNS.items()
        ],
    }
