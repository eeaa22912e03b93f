"""The failure of one message, told without knowing its topic or file."""


class BadMessage(ValueError):
    """A message contradicts itself: ``problem`` names the value, ``advice`` what to do."""

    def __init__(self, problem: str, advice: str) -> None:
        super().__init__(problem)
        self.problem = problem
        self.advice = advice
