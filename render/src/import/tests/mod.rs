//! Tests of the importer as a whole; those of one topic stand beside this file.

mod bad_input;
mod builder;
mod container;
mod geometry;
mod images;
mod material;
mod mutation;
mod nodes;
mod reference;
mod views;
