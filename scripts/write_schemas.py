"""Write the JSON Schemas of the messages to ``schemas/``, one file each.

Usage: .venv/bin/python scripts/write_schemas.py
"""

import json
from pathlib import Path

from vo_service.outputs.zenoh.json_schemas import all_schemas

SCHEMA_FOLDER = Path(__file__).parents[1] / "schemas"


def make_schema_files() -> dict[str, str]:
    """Return the text of each schema file by its name."""
    return {
        f"{name}.json": json.dumps(schema, indent=2) + "\n"
        for name, schema in all_schemas().items()
    }


def main() -> None:
    """Write all schema files and delete stale ones."""
    SCHEMA_FOLDER.mkdir(exist_ok=True)
    files = make_schema_files()
    for stale in SCHEMA_FOLDER.glob("*.json"):
        if stale.name not in files:
            stale.unlink()
    for name, text in files.items():
        (SCHEMA_FOLDER / name).write_text(text)


if __name__ == "__main__":
    main()
