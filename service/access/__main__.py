"""`python -m service.access`: make, list and revoke keys where they lie, which is how the first one comes to be."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel, ValidationError

from backend.settings import BackendSettings, setting_faults
from backend.store import Store
from schemas.access import KeyLimits, NewKey, Scope
from schemas.errors import SilhouetteError
from service.access.keys import KeyStore


def main() -> int:
    """Do what the arguments say; the exit status. Results are JSON on standard output."""
    flags = _parse(sys.argv[1:])
    try:
        settings = BackendSettings() if flags.data_dir is None else BackendSettings(data_dir=flags.data_dir)
        stored = KeyStore(Store(settings.store_dir))
        if flags.verb == "add":
            limits = {name: getattr(flags, name) for name in KeyLimits.model_fields}
            wanted = NewKey(name=flags.name, scopes=flags.scope, expires_in_days=flags.expires_in_days, limits=KeyLimits(**limits))
            _print(stored.add(wanted))
        elif flags.verb == "list":
            for record in stored.all():
                _print(record.info())
        else:
            stored.revoke(flags.id)
    except ValidationError as error:
        return _fail(*setting_faults(error))
    except SilhouetteError as error:
        return _fail(error.message)
    except OSError as error:
        return _fail(f"{error.filename}: {error.strerror}")
    return 0


def _parse(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m service.access", description="API keys in the object store that the settings name.")
    parser.add_argument("--data-dir", type=Path, help="folder of everything that is kept")
    verbs = parser.add_subparsers(dest="verb", required=True)
    add = verbs.add_parser("add", help="make a key and print it with its token")
    add.add_argument("name")
    add.add_argument("--scope", action="append", required=True, choices=[scope.value for scope in Scope])
    add.add_argument("--expires-in-days", type=float)
    for name, field in KeyLimits.model_fields.items():
        add.add_argument(f"--{name.replace('_', '-')}", type=int, help=field.description)
    verbs.add_parser("list", help="print all keys, one a line")
    verbs.add_parser("revoke", help="remove a key").add_argument("id")
    return parser.parse_args(arguments)


def _print(found: BaseModel) -> None:
    print(found.model_dump_json(exclude_none=True))


def _fail(*messages: str) -> int:
    print(*(f"error: {message}" for message in messages), sep="\n", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
