//! Scenes: description, building, the scene space, cameras and plans.

pub mod description;
