"""pamid: grey-box models of pneumatic joints and drives, and the causes of their gap to measured data."""

__version__ = "0.1.0"
