//! The simulated street: recordings with exact truth, for tests and the demo.
