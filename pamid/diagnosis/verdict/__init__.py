"""The answer of a diagnosis for its readers: diagnosis.json, its sentences and notes, where the gap
shows, and the description of what remains."""
