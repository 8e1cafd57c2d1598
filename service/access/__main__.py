"""`python -m service.access`: make, list and revoke keys where they lie, which is how the first one comes to be."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pydantic import ValidationError

from backend.settings import BackendSettings, setting_faults
from backend.stores import open_store
from schemas.access import KeyPage, NewKey
from schemas.errors import SilhouetteError
from service.access.keys import KeyStore


def main() -> int:
    """Do what the arguments say; the exit status. What is found or made is JSON on standard output, as the API has it."""
    parser = argparse.ArgumentParser(prog="python -m service.access", description="API keys in the object store that the settings name.")
    parser.add_argument("--data-dir", type=Path, help="folder of everything that is kept")
    verbs = parser.add_subparsers(dest="verb", required=True)
    verbs.add_parser("add", help="make the key whose description is on standard input, as POST /v1/keys takes it")
    verbs.add_parser("list", help="print all keys")
    verbs.add_parser("revoke", help="remove a key").add_argument("id")
    flags = parser.parse_args()
    try:
        settings = BackendSettings() if flags.data_dir is None else BackendSettings(data_dir=flags.data_dir)
    except ValidationError as error:
        return _fail(*setting_faults(error))
    try:
        _run(flags, KeyStore(open_store(settings)))
    except ValidationError as error:
        from service.errors import invalid_fields  # only now: with it comes the whole web framework

        return _fail(*(f"{fault['field']}: {fault['message']}" for fault in invalid_fields(error.errors())))
    except SilhouetteError as error:
        return _fail(error.message)
    except OSError as error:
        return _fail(f"{error.filename}: {error.strerror}")
    return 0


def _run(flags: argparse.Namespace, stored: KeyStore) -> None:
    if flags.verb == "add":
        made = stored.add(NewKey.model_validate_json(sys.stdin.buffer.read()))
        print(made.model_dump_json(exclude_none=True))
    elif flags.verb == "list":
        print(KeyPage(keys=[record.info() for record in stored.all()]).model_dump_json(exclude_none=True))
    else:
        stored.revoke(flags.id)


def _fail(*messages: str) -> int:
    print(*messages, sep="\n", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
