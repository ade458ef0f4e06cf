"""Commands of this distribution: ``avrare sensitivity``, ``avrare require``, ``avrare synthesise``."""
