//! The parameters of a program: numbered, and named ones, local to a subprogram or global.

use std::collections::HashMap;

/// Highest number of a parameter.
pub(super) const NUMBER_MAX: u16 = 9_999;

/// Numbers that belong to each call: the arguments of a subprogram.
pub(super) const ARGUMENTS: usize = 30;

/// Numbers that the machine itself keeps: they can be read, and set only by the words that are for that.
pub(super) const SYSTEM: std::ops::RangeInclusive<u16> = 5_061..=5_602;

/// Values of parameters; a numbered one that was never set has none.
#[derive(Debug)]
pub(super) struct Parameters {
    numbered: Vec<Option<f64>>,
    global: HashMap<String, f64>,
    /// Those of the main program, then of each call.
    local: Vec<HashMap<String, f64>>,
}

impl Default for Parameters {
    fn default() -> Self {
        Self {
            numbered: vec![None; usize::from(NUMBER_MAX) + 1],
            global: HashMap::new(),
            local: vec![HashMap::new()],
        }
    }
}

/// What a call must put back: the caller's numbers 1 to 30.
#[derive(Clone, Debug)]
pub(super) struct Kept([Option<f64>; ARGUMENTS]);

impl Parameters {
    pub(super) fn number(&self, number: u16) -> Option<f64> {
        self.numbered[usize::from(number)]
    }

    pub(super) fn set_number(&mut self, number: u16, value: f64) {
        self.numbered[usize::from(number)] = Some(value);
    }

    /// A named parameter; those that begin with `_` are global.
    pub(super) fn named(&self, name: &str) -> Option<f64> {
        let map = if name.starts_with('_') {
            &self.global
        } else {
            self.local.last()?
        };
        map.get(name).copied()
    }

    pub(super) fn set_named(&mut self, name: String, value: f64) {
        if name.starts_with('_') {
            self.global.insert(name, value);
        } else if let Some(local) = self.local.last_mut() {
            local.insert(name, value);
        }
    }

    /// Begins a call: its arguments are the numbers from 1 on, the other numbers up to 30 are 0.
    pub(super) fn enter(&mut self, arguments: &[f64]) -> Kept {
        let mut kept = Kept([None; ARGUMENTS]);
        kept.0.copy_from_slice(&self.numbered[1..=ARGUMENTS]);
        self.numbered[1..=ARGUMENTS].fill(Some(0.0));
        for (place, argument) in self.numbered[1..].iter_mut().zip(arguments) {
            *place = Some(*argument);
        }
        self.local.push(HashMap::new());
        kept
    }

    /// Ends a call.
    pub(super) fn leave(&mut self, kept: &Kept) {
        self.numbered[1..=ARGUMENTS].copy_from_slice(&kept.0);
        self.local.pop();
    }
}
