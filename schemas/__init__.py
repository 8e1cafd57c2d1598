"""The contract: everything that crosses a boundary between processes. numpy and pydantic only."""
