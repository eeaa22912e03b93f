"""A cloud file that contradicts itself."""

_COPY_AGAIN = "Copy it again from its source."


class BadCloud(ValueError):
    """``str(error)`` says what is wrong as part of a sentence, ``advice`` what to do."""

    def __init__(self, problem: str, advice: str = _COPY_AGAIN) -> None:
        super().__init__(problem)
        self.advice = advice
