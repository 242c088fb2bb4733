"""`python -m pamid_cli`, for where scripts are not on the path."""

from .frame import main

main()
