"""The error of a single message, raised where its topic and file are not known."""


class BadMessage(ValueError):
    """A message contradicts itself: ``problem`` names the value, ``advice`` what to do."""

    def __init__(self, problem: str, advice: str) -> None:
        super().__init__(problem)
        self.problem = problem
        self.advice = advice
