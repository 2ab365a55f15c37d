//! Lights: emission and sampling.
