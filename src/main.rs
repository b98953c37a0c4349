//! The command line of union3d.
fn main() {}
