"""The diagnosis: where the gap lies, which effect causes it, how far it shrinks. One file per
question."""
