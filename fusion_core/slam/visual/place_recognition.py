"""Place recognition: keyframes that look like an image, by an inverted index of binary words.

ORB-SLAM2 looks words up in a vocabulary that was fitted to images beforehand (Gálvez-López & Tardós
2012). Here a word is a sample of a descriptor's bits, as in locality-sensitive hashing (Gionis,
Indyk & Motwani 1999): two descriptors that differ in d of their 256 bits share a word of b bits
with probability (1 - d/256)^b, so that of several words one is shared. Nothing is fitted to any
recording. Images vote by the words' inverse document frequency (Sivic & Zisserman 2003).
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray, IntArray, read_only
from fusion_core.settings import StageSettings, setting

_DESCRIPTOR_BITS = 256
# Chooses the bits of the words; the same in each run, so that indices agree.
_BITS_SEED = 20_170_612
# A posting is one whole number: the word above, the image below.
_IMAGE_BITS = 28
_IMAGE_MASK = (1 << _IMAGE_BITS) - 1
# Words of several tables are told apart by the bits above the word's own.
_WORD_BITS_MAX = 28


class PlaceSettings(StageSettings):
    """The index of places."""

    tables: int = setting(8, "Words of each feature", ge=1, le=64)
    word_bits: int = setting(
        20, "Bits of a descriptor in a word", unit="bits", ge=4, le=_WORD_BITS_MAX
    )
    postings_max: int = setting(
        64,
        "Images looked up for a word, the oldest first; bounds the time of a query",
        unit="images",
        ge=1,
        le=100_000,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaceScores:
    """The images of an index by likeness to a query, best first.

    ``images``: (N,) their numbers. ``scores``: (N,) the part of the query's words, weighted by
    rarity, that an image shares, from 0 to 1.
    """

    images: IntArray
    scores: FloatArray

    def __post_init__(self) -> None:
        for array in (self.images, self.scores):
            read_only(array)


class PlaceIndex:
    """Which images have which words.

    Postings are sorted runs, each at most half as long as the one before it: adding an image
    merges runs, and a query searches each of the few. Both take a time that grows with the
    logarithm of the number of images.
    """

    def __init__(self, settings: PlaceSettings | None = None) -> None:
        self._settings = settings or PlaceSettings()
        rng = np.random.default_rng(_BITS_SEED)
        bits, tables = self._settings.word_bits, self._settings.tables
        self._bits = np.array(
            [rng.choice(_DESCRIPTOR_BITS, bits, replace=False) for _ in range(tables)]
        )
        self._runs: list[IntArray] = []
        self._images: set[int] = set()
        self._removed: set[int] = set()

    def __len__(self) -> int:
        return len(self._images)

    def add(self, image: int, descriptors: ByteArray) -> None:
        """Add an image by its (F, 32) descriptors; its number is from 0 to 2^28 - 1."""
        if image in self._images | self._removed or not 0 <= image <= _IMAGE_MASK:
            raise ValueError(f"image {image} is in the index already, or no number of an image")
        self._images.add(image)
        run = self._words(descriptors) << _IMAGE_BITS | image
        while self._runs and len(self._runs[-1]) <= 2 * len(run):
            # A stable sort merges two sorted runs in linear time.
            run = np.sort(np.concatenate([self._runs.pop(), run]), kind="stable")
            if self._removed:
                run = run[~np.isin(run & _IMAGE_MASK, sorted(self._removed))]
        self._runs.append(run)

    def remove(self, image: int) -> None:
        """Leave an image out. Its words go when runs are merged; until then they count."""
        self._images.remove(image)
        self._removed.add(image)

    @property
    def images(self) -> frozenset[int]:
        """Those in the index."""
        return frozenset(self._images)

    def query(self, descriptors: ByteArray) -> PlaceScores:
        """The images that share words with (F, 32) descriptors; those of one score by number."""
        if not self._images:
            return PlaceScores(images=np.empty(0, np.int64), scores=np.empty(0))
        words = self._words(descriptors)
        count = len(self._images)
        begins = [np.searchsorted(run, words << _IMAGE_BITS) for run in self._runs]
        ends = [np.searchsorted(run, (words + 1) << _IMAGE_BITS) for run in self._runs]
        lengths = [end - begin for begin, end in zip(begins, ends, strict=True)]
        document_frequency = np.sum(lengths, axis=0)
        # A word that no image has weighs as much as one that a single image has.
        idf = np.log1p(count / np.maximum(document_frequency, 1))
        votes = np.zeros(max(self._images | self._removed) + 1)
        left = np.full(len(words), self._settings.postings_max)
        # Merging keeps images in order within a run, and the first run has the oldest.
        for run, begin, length in zip(self._runs, begins, lengths, strict=True):
            taken = np.minimum(length, left)
            left -= taken
            postings = np.repeat(begin - np.cumsum(taken) + taken, taken) + np.arange(taken.sum())
            votes += np.bincount(
                run[postings] & _IMAGE_MASK, np.repeat(idf, taken), minlength=len(votes)
            )
        votes[sorted(self._removed)] = 0.0
        voted = np.flatnonzero(votes)
        order = np.argsort(-votes[voted], kind="stable")
        total = max(float(idf.sum()), np.finfo(np.float64).tiny)
        return PlaceScores(images=voted[order], scores=votes[voted][order] / total)

    def _words(self, descriptors: ByteArray) -> IntArray:
        """(W,) the distinct words of (F, 32) descriptors, ascending."""
        bits = np.unpackbits(descriptors, axis=1)
        place = 1 << np.arange(self._settings.word_bits, dtype=np.int64)
        words = bits[:, self._bits].astype(np.int64) @ place
        tables = np.arange(self._settings.tables, dtype=np.int64)
        return np.unique(words + (tables << self._settings.word_bits))
