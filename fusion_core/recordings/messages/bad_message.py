"""The error of a single message, raised where its topic and file are not known."""


class BadMessage(ValueError):
    """An invalid message: ``problem`` names the value, ``advice`` a remedy."""

    def __init__(self, problem: str, advice: str) -> None:
        super().__init__(problem)
        self.problem = problem
        self.advice = advice
