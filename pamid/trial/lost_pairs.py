"""Where a pair was lost: the first gate between the screen and the verdict that one of two planted
faults did not pass."""

from __future__ import annotations

from pamid.trial.marking import Marked

#: gate -> what it says, in the order in which a pair meets them
PAIR_GATES = {
    "unseen": "one does not show beside the other",
    "nothing-sought": "nothing was looked for beside the first effect",
    "screen": "one was never refitted, by itself or with another",
    "ports": "not refitted together: little was missing where one of them acts",
    "refits": "not among the combinations refitted together",
    "losses": "refitted together, but another combination had the lower held-out error",
    "further": "the second was not taken to be real",
    "verdict": "both were in the model, and the verdict does not name them",
}


def lost_at(m: Marked) -> str:
    """The gate that lost one of two planted faults; "" where both were named, or fewer planted."""
    pair = {str(t["family"]) for t in m.truth}
    if len(pair) < 2 or m.caught == len(pair):
        return ""
    steps = m.found.get("further", ())
    together = [[set(families) for families in step.get("tried", ())] for step in steps]
    refitted = set(m.families).union(*(families for tried in together for families in tried))
    weighed = [
        (step, tried)
        for step, tried in zip(steps, together, strict=True)
        if any(pair <= families for families in tried)
    ]
    foremost = [step for step, tried in weighed if pair <= tried[0]]
    met = {
        "unseen": not m.each_visible,
        "nothing-sought": not steps,
        "screen": not pair <= refitted,
        "ports": not weighed and any(pair & set(step.get("closed", ())) for step in steps),
        "refits": not weighed,
        "losses": not foremost,
        "further": not any(step["taken"] for step in foremost),
        "verdict": True,
    }
    return next(gate for gate in PAIR_GATES if met[gate])
