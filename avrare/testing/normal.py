"""Standard normal distribution on arrays, under the names that the testing kit gives them."""

from avrare.base.special import normal_cdf as cdf
from avrare.base.special import normal_log_cdf as log_cdf
from avrare.base.special import normal_pdf as pdf
from avrare.base.special import normal_probability as probability

__all__ = ["cdf", "log_cdf", "pdf", "probability"]
