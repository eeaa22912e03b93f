"""What is killed: a program that labels at random and tells each action that is committed."""

from multiprocessing.connection import Connection
from random import Random

from fusion_core.annotation.store import LabelStore
from fusion_core.model.errors import ScanLoomError
from tests.annotation.plain_labels import random_operation
from tests.annotation.samples import RECORDING


def label_until_killed(address: str, seed: int, told: Connection) -> None:
    """Send 0 when the store is open, then the number of each action; end where the store fails."""
    random = Random(seed)
    try:
        with LabelStore.open(address, RECORDING, create=True) as store:
            told.send(0)
            while True:
                number = random_operation(random).apply(store)
                if number is not None:
                    told.send(number)
    except ScanLoomError:
        # The server is gone.
        return
