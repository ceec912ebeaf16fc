"""Write the JSON Schemas of the messages into ``schemas/``, one file each.

Usage: .venv/bin/python scripts/write_schemas.py
"""

import json
from pathlib import Path

from vo_service.outputs.zenoh.json_schemas import all_schemas

SCHEMA_FOLDER = Path(__file__).parents[1] / "schemas"


def make_schema_files() -> dict[str, str]:
    """What each file is to hold, by its name."""
    return {
        f"{name}.json": json.dumps(schema, indent=2) + "\n"
        for name, schema in all_schemas().items()
    }


def main() -> None:
    """Write them all; a file that is no longer one of them goes."""
    SCHEMA_FOLDER.mkdir(exist_ok=True)
    wanted = make_schema_files()
    for stale in SCHEMA_FOLDER.glob("*.json"):
        if stale.name not in wanted:
            stale.unlink()
    for name, text in wanted.items():
        (SCHEMA_FOLDER / name).write_text(text)


if __name__ == "__main__":
    main()
