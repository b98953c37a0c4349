//! The tools of a machine: lengths and diameters for the path, shapes for the cut.

mod linuxcnc;

use std::collections::BTreeMap;

/// One tool.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Tool {
    /// Diameter for cutter compensation; negative is on the other side. Units: mm.
    pub diameter: Option<f64>,
    /// What G43 takes off the machine's position. Units: mm.
    pub offset: [f64; 3],
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
}
