//! Bytes to operations: JSON, lines of JSON, protobuf. Nothing is submitted that has a fault.

mod change;
mod json;
mod message;
mod recover;
#[cfg(test)]
mod tests;

pub use self::change::{change, change_faults, file_line, line};
pub use self::message::{
    change_message, change_message_duplicates, message, message_duplicates, settings_message,
};
use super::convert::{InvalidSetting, Settings, SettingsDocument};
use super::documents::Revert;
use super::problem::{Code, Fault, Faults, Problem};
use crate::service::{Motion, Operations, Seq};

/// A decoded atomic change.
#[derive(Debug)]
pub struct Decoded {
    /// What to do: the deletions first.
    pub operations: Operations,
    /// How many of the operations are deletions.
    pub deletions: usize,
    /// What the change belongs to.
    pub motion: Motion,
}

/// Reads the settings of a scene.
/// # Errors
/// [`Code::BadJson`], or [`Code::Invalid`] with every fault.
pub fn settings(body: &[u8]) -> Result<Settings, Problem> {
    let wanted = json::read(body, |wanted: &SettingsDocument, faults| {
        if let Err(invalid) = Settings::check(wanted) {
            note_settings(&invalid, faults);
        }
    })?;
    Settings::check(&wanted)
        .map_err(|_| Problem::new(Code::Internal, "settings have neither faults nor meaning"))
}

/// Notes what is wrong with settings; a field that could not be read has its fault already, and a stand-in was checked.
fn note_settings(invalid: &[InvalidSetting], faults: &mut Faults) {
    let unread: Vec<bool> = invalid
        .iter()
        .map(|invalid| faults.cover(&format!("/{}", invalid.field())))
        .collect();
    for (invalid, unread) in invalid.iter().zip(unread) {
        if !unread {
            let pointer = format!("/{}", invalid.place());
            faults.push(Fault::at(pointer, invalid.to_string(), None));
        }
    }
}

/// Reads what to revert to: `{"to":3}`.
/// # Errors
/// [`Code::BadJson`], or [`Code::Invalid`] with every fault.
pub fn revert(body: &[u8]) -> Result<Seq, Problem> {
    let Revert { to } = json::read(body, |_: &Revert, _| ())?;
    Ok(Seq(to))
}

fn too_many(cubes_max: usize) -> Problem {
    Problem::new(
        Code::TooLarge,
        format!("the change names more than {cubes_max} cubes, deletions and insertions together"),
    )
}
