//! The shapes of a scene: numbered in the order in which they were defined, found by their names.
//!
//! ```text
//! definition   version  name  document  top  parts...    name and document: length (varint), UTF-8
//! top          0, or 1 and its height                     little-endian
//! part         vertices (varint), then x, y, z of each   little-endian
//! ```

use std::collections::HashMap;
use std::sync::Arc;

use crate::engine::solids::Shape;
use crate::geometry::convex::{Point, Solid, VERTICES_MAX};
use crate::log::{Malformed, Reader, put_varint};

/// Most shapes of a scene. The shape of a body that is written is looked for among all of them.
pub const SHAPES_MAX: usize = 1024;

const DEFINITION_VERSION: u8 = 1;

/// A shape with its name.
#[derive(Clone, Debug)]
pub struct NamedShape {
    /// Its name.
    pub name: String,
    /// What it was read from, as those above wrote it: opaque here.
    pub document: String,
    /// What it is.
    pub shape: Arc<Shape>,
}

/// The shapes of a scene. Cheap to clone.
#[derive(Clone, Debug, Default)]
pub struct Shapes {
    by_number: Vec<Arc<NamedShape>>,
    by_name: HashMap<String, usize>,
}

impl NamedShape {
    /// As the log keeps it.
    pub fn definition(&self) -> Box<[u8]> {
        let mut bytes = vec![DEFINITION_VERSION];
        for text in [&self.name, &self.document] {
            put_count(&mut bytes, text.len());
            bytes.extend_from_slice(text.as_bytes());
        }
        match self.shape.top() {
            None => bytes.push(0),
            Some(top) => {
                bytes.push(1);
                bytes.extend(top.to_le_bytes());
            }
        }
        let parts = self.shape.parts();
        put_count(&mut bytes, parts.len());
        for part in parts {
            put_part(&mut bytes, part);
        }
        bytes.into()
    }

    /// The shape of a definition.
    /// # Errors
    /// Whatever is none.
    pub(super) fn read(definition: &[u8]) -> Result<Self, Malformed> {
        let mut reader = Reader(definition);
        if reader.byte()? != DEFINITION_VERSION {
            return Err(Malformed("a shape of an unknown version"));
        }
        let (name, document) = (text(&mut reader)?, text(&mut reader)?);
        let top = match reader.byte()? {
            0 => None,
            1 => Some(i32::from_le_bytes(reader.array()?)),
            _ => return Err(Malformed("a top that is neither there nor not")),
        };
        let mut parts = Vec::new();
        for _ in 0..count(&mut reader)? {
            parts.push(part(&mut reader)?);
        }
        reader.finish()?;
        let shape = Shape::new(parts).map_err(|_| Malformed("a shape of too few or many parts"))?;
        let shape = match top {
            None => shape,
            Some(top) => shape.with_top(top),
        };
        Ok(Self {
            name,
            document,
            shape: Arc::new(shape),
        })
    }
}

fn put_count(to: &mut Vec<u8>, count: usize) {
    put_varint(to, count as u64);
}

fn count(reader: &mut Reader<'_>) -> Result<usize, Malformed> {
    usize::try_from(reader.varint()?).map_err(|_| Malformed("a count that is too large"))
}

fn text(reader: &mut Reader<'_>) -> Result<String, Malformed> {
    let length = count(reader)?;
    let bytes = reader.bytes(length)?;
    let text = std::str::from_utf8(bytes).map_err(|_| Malformed("a text is not UTF-8"))?;
    Ok(text.to_owned())
}

/// Appends a convex solid.
pub(super) fn put_part(to: &mut Vec<u8>, part: &Solid) {
    put_count(to, part.vertices().len());
    for vertex in part.vertices() {
        for coordinate in vertex.coordinates() {
            to.extend(coordinate.to_le_bytes());
        }
    }
}

/// The convex solid that [`put_part`] wrote.
pub(super) fn part(reader: &mut Reader<'_>) -> Result<Solid, Malformed> {
    let vertices = count(reader)?;
    if vertices > VERTICES_MAX {
        return Err(Malformed("a part of too many vertices"));
    }
    let mut points = Vec::new();
    for _ in 0..vertices {
        let mut coordinates = [0; 3];
        for coordinate in &mut coordinates {
            *coordinate = i64::from(i32::from_le_bytes(reader.array()?));
        }
        points
            .push(Point::new(coordinates).map_err(|_| Malformed("a vertex outside the lattice"))?);
    }
    Solid::hull(&points).map_err(|_| Malformed("a part that is no solid"))
}

impl Shapes {
    /// All of them, in the order in which they were defined.
    pub fn iter(&self) -> impl Iterator<Item = &NamedShape> {
        self.by_number.iter().map(|shape| &**shape)
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.by_number.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.by_number.is_empty()
    }

    /// The shape of a name.
    pub fn get(&self, name: &str) -> Option<&NamedShape> {
        let number = self.by_name.get(name)?;
        self.by_number.get(*number).map(|shape| &**shape)
    }

    /// The shape that a body was made of.
    pub fn of(&self, shape: &Arc<Shape>) -> Option<&NamedShape> {
        let number = self.number(shape)?;
        self.by_number.get(number).map(|shape| &**shape)
    }

    /// The number of the shape that a body was made of. By its identity: two names may stand for equal shapes. One that was
    /// made before the scene was last replayed is another object, so the second try is by what it is.
    pub(super) fn number(&self, shape: &Arc<Shape>) -> Option<usize> {
        let mut numbered = self.by_number.iter();
        let same = numbered.position(|named| Arc::ptr_eq(&named.shape, shape));
        same.or_else(|| {
            self.by_number
                .iter()
                .position(|named| named.shape == *shape)
        })
    }

    pub(super) fn by_number(&self, number: usize) -> Option<&Arc<Shape>> {
        self.by_number.get(number).map(|named| &named.shape)
    }

    /// Whether exactly this shape is there.
    pub(super) fn has(&self, shape: &NamedShape) -> bool {
        let there = self.get(&shape.name);
        there.is_some_and(|there| there.shape == shape.shape)
    }

    /// Adds a shape.
    pub(super) fn push(&mut self, shape: NamedShape) -> Result<(), Malformed> {
        if self.by_name.contains_key(&shape.name) {
            return Err(Malformed(
                "there is another shape of this name, and a shape never changes",
            ));
        }
        if self.len() == SHAPES_MAX {
            return Err(Malformed("the scene has as many shapes as it may, 1024"));
        }
        self.by_name.insert(shape.name.clone(), self.len());
        self.by_number.push(Arc::new(shape));
        Ok(())
    }
}
