"""The uses beside named baselines, by the rules of docs/uses_protocol.rst."""
