//! Tests of the importer as a whole; those of one topic stand beside this file.

mod reference;
