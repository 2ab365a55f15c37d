//! kdtree
