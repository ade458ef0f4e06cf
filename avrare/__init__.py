"""avrare: how likely is this driving stack to break this traffic rule?"""

__version__ = "0.1.0"
