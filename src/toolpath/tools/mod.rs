//! The tools of a machine: lengths and diameters for the path, shapes for the cut.

mod comment;
mod definition;
mod freecad;
mod fusion;
mod linuxcnc;
mod shape;

use std::collections::BTreeMap;

pub use freecad::{Bit, bit, bits};
pub use shape::{Cone, ToolEnd, ToolShape};

/// One tool.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Tool {
    /// Diameter for cutter compensation; negative is on the other side. Units: mm.
    pub diameter: Option<f64>,
    /// What G43 takes off the machine's position. Units: mm.
    pub offset: [f64; 3],
    /// What it cuts with, and what must not touch the material.
    pub shape: Shaped,
}

/// What is known of the shape of a tool.
#[derive(Clone, PartialEq, Debug, Default)]
pub enum Shaped {
    /// Nothing.
    #[default]
    Unknown,
    /// There is something, but not what is needed; why.
    Unsupported(String),
    /// It was given.
    Given(ToolShape),
    /// It was read from a comment of the program, on this line.
    Comment(ToolShape, u64),
}

/// Tools by number.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct ToolTable {
    tools: BTreeMap<u32, Tool>,
}

impl ToolTable {
    /// A tool by its number.
    pub fn get(&self, number: u32) -> Option<&Tool> {
        self.tools.get(&number)
    }

    /// A tool by its number, made when it is not there.
    pub fn entry(&mut self, number: u32) -> &mut Tool {
        self.tools.entry(number).or_default()
    }

    /// All tools, by their numbers.
    pub fn tools(&self) -> impl Iterator<Item = (u32, &Tool)> {
        self.tools.iter().map(|(number, tool)| (*number, tool))
    }

    /// Whether a tool has a shape that was not read from a comment.
    fn is_shaped(&self, number: u32) -> bool {
        matches!(self.get(number), Some(tool) if matches!(tool.shape, Shaped::Given(_)))
    }

    /// Gives a tool its shape, whatever it was before; the diameter for compensation, too, unless that is known.
    pub fn give(&mut self, number: u32, shape: ToolShape) {
        let tool = self.entry(number);
        tool.diameter.get_or_insert(shape.diameter);
        tool.shape = Shaped::Given(shape);
    }
}
