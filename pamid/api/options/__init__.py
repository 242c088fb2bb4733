"""Arguments of the verbs: records from which the Python functions and the commands are generated.

Nothing heavy is imported here, so that `pamid COMMAND --help` responds at once.
"""
