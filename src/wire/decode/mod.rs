//! Bytes to operations: JSON, lines of JSON, protobuf. Nothing is submitted that has a fault.

mod batch;
mod change;
mod json;
mod message;
mod recover;
mod solid_message;
#[cfg(test)]
mod tests;

use std::cell::{Cell, RefCell};

use serde::Deserialize;

pub(super) use self::batch::{Keyed, batch, batch_message};
pub use self::change::{change, change_faults, file_line, line};
pub use self::message::{
    change_message, change_message_duplicates, message, message_duplicates, settings_message,
};
pub use self::solid_message::{solid_change_message, solid_message};
use super::convert::{InvalidSetting, KindName, Settings, SettingsDocument};
pub use super::decoded::Decoded;
use super::documents::{AuditRequest, LineOperation, Revert};
use super::problem::{Code, Fault, Faults, Problem};
use super::solids::{
    self, NewSolids, Scale, ShapeDocument, SolidChange, SolidDocument, SolidSettingsDocument,
};
use crate::engine::Op;
use crate::engine::solids::Body;
use crate::service::{NamedShape, Seq, Shapes, Solids};

/// Whether settings are of a scene of solids; they are of cubes when they do not say.
pub(super) fn is_of_solids(body: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct OfKind {
        kind: KindName,
    }
    let read = serde_json::from_slice(body);
    read.is_ok_and(|OfKind { kind }| kind == KindName::Solids)
}

/// Reads the settings of a scene of solids.
/// # Errors
/// [`Code::BadJson`], or [`Code::Invalid`] with every fault.
pub(super) fn solid_settings(body: &[u8]) -> Result<NewSolids, Problem> {
    let new = RefCell::new(None);
    json::read(body, |wanted: &SolidSettingsDocument, faults| {
        new.replace(solids::check(wanted, faults));
    })?;
    sound(new.into_inner(), Faults::default())
}

/// The settings of a scene of solids in a document that had these faults already.
/// # Errors
/// [`Code::Invalid`] with every fault.
pub(super) fn solid_settings_document(
    wanted: &SolidSettingsDocument,
    mut faults: Faults,
) -> Result<NewSolids, Problem> {
    let new = solids::check(wanted, &mut faults);
    sound(new, faults)
}

/// Reads a shape of a scene of solids.
/// # Errors
/// [`Code::BadJson`], or [`Code::Invalid`] with every fault.
pub(super) fn shape(body: &[u8], name: &str, scale: Scale) -> Result<NamedShape, Problem> {
    let shape = RefCell::new(None);
    json::read(body, |document: &ShapeDocument, faults| {
        shape.replace(named_shape(document, name, scale, faults));
    })?;
    sound(shape.into_inner(), Faults::default())
}

/// The shape of a document that had these faults already.
/// # Errors
/// [`Code::Invalid`] with every fault.
pub(super) fn shape_document(
    document: Option<&ShapeDocument>,
    name: &str,
    scale: Scale,
    mut faults: Faults,
) -> Result<NamedShape, Problem> {
    let shape = document.and_then(|document| named_shape(document, name, scale, &mut faults));
    sound(shape, faults)
}

/// The shape, or none and why.
fn named_shape(
    document: &ShapeDocument,
    name: &str,
    scale: Scale,
    faults: &mut Faults,
) -> Option<NamedShape> {
    match solids::named_shape(name, document, scale) {
        Ok(named) => return Some(named),
        Err((pointer, detail)) if !faults.cover(&pointer) => {
            faults.push(Fault::at(pointer, detail, None));
        }
        Err(_) => {}
    }
    None
}

/// What was read, when there is no fault.
fn sound<T>(read: Option<T>, faults: Faults) -> Result<T, Problem> {
    if !faults.is_empty() {
        return Err(faults.into_problem());
    }
    read.ok_or_else(|| {
        Problem::new(
            Code::Internal,
            "what was read has neither faults nor meaning",
        )
    })
}

/// Reads an atomic change of solids.
/// # Errors
/// [`Code::BadJson`], [`Code::TooLarge`] above `solids_max`, or [`Code::Invalid`] with every fault.
pub(super) fn solid_change(
    body: &[u8],
    shapes: &Shapes,
    scale: Scale,
    solids_max: usize,
) -> Result<Decoded<Solids>, Problem> {
    let (decoded, named) = (RefCell::new(None), Cell::new(0));
    json::read(body, |change: &SolidChange, faults| {
        named.set(change.delete.len() + change.insert.len());
        if named.get() <= solids_max {
            decoded.replace(solids::decoded(change, shapes, scale, faults));
        }
    })?;
    if named.get() > solids_max {
        return Err(too_many(solids_max));
    }
    sound(decoded.into_inner(), Faults::default())
}

/// Reads one line of a stream of solids: `{"insert":{"id":1,"shape":"t1","from":[..],"to":[..]}}` or `{"delete":1}`.
/// # Errors
/// [`Code::BadJson`] or [`Code::Invalid`]; the caller knows the line's number.
pub(super) fn solid_line(text: &[u8], shapes: &Shapes, scale: Scale) -> Result<Op<Body>, Problem> {
    let operation = RefCell::new(None);
    json::read_line(text, |line: &LineOperation<SolidDocument>, faults| {
        operation.replace(solids::operation(line, shapes, scale, faults));
    })?;
    sound(operation.into_inner(), Faults::default())
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

/// Reads what an audit is asked with: nothing, or `{}`.
/// # Errors
/// As of [`revert`].
pub fn audit(body: &[u8]) -> Result<(), Problem> {
    if body.is_empty() {
        return Ok(());
    }
    let AuditRequest {} = json::read(body, |_: &AuditRequest, _| ())?;
    Ok(())
}

fn too_many(cubes_max: usize) -> Problem {
    Problem::new(
        Code::TooLarge,
        format!("the change names more than {cubes_max} cubes, deletions and insertions together"),
    )
}
