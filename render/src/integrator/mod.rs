//! Integrators: estimators of the light that reaches the camera.
