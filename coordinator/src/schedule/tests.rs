//! Event lists in, command lists out.
