//! Meshes as files: written triangle by triangle, read back when they are whole.
//!
//! ```text
//!   triangles ─┬─ STL ─────────────────────────────────────> the file, its count at the end
//!              ├─ OBJ ── numbered vertices ────────────────> the file
//!              └─ PLY, GLB, 3MF ── numbered vertices in memory, triangles in a file beside ── at the end ──> the file
//! ```
//! What is exact: nothing is rounded in PLY, OBJ and 3MF beyond the quotient of steps and steps per unit. STL and GLB hold numbers of 32 bits;
//! triangles of which two corners become one are left out there, in pairs of edges, so that the mesh stays closed.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};

use rustc_hash::FxHashMap;
use serde_json::json;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::face::Face;
use super::mesh::{Triangle, Triangulator};

/// Bytes before the triangles of an STL file: a line of text, and the count.
const STL_TEXT_BYTES: usize = 80;

/// Most triangles that a file can count.
const TRIANGLES_MAX: u64 = u32::MAX as u64 / 3;

/// How a mesh is written.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Format {
    /// Binary STL: numbers of 32 bits.
    Stl,
    /// Binary PLY, little endian: numbers of 64 bits.
    Ply,
    /// OBJ.
    Obj,
    /// 3MF.
    ThreeMf,
    /// Binary glTF 2.0: numbers of 32 bits.
    Glb,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Stl, Self::Ply, Self::Obj, Self::ThreeMf, Self::Glb];

    /// Its name, which is the extension of such files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stl => "stl",
            Self::Ply => "ply",
            Self::Obj => "obj",
            Self::ThreeMf => "3mf",
            Self::Glb => "glb",
        }
    }

    /// The format of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    /// Its media type.
    pub const fn media_type(self) -> &'static str {
        match self {
            Self::Stl => "model/stl",
            Self::Ply => "application/ply",
            Self::Obj => "model/obj",
            Self::ThreeMf => "model/3mf",
            Self::Glb => "model/gltf-binary",
        }
    }

    /// Whether its numbers have 32 bits.
    const fn is_narrow(self) -> bool {
        matches!(self, Self::Stl | Self::Glb)
    }
}

/// Why a mesh is not written.
#[derive(Debug, thiserror::Error)]
pub enum MeshError {
    /// It has more triangles than may be.
    #[error("the mesh has more than {triangles_max} triangles")]
    TooMany {
        /// How many there may be.
        triangles_max: u64,
    },
    /// A file cannot be written.
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// A mesh on its way into a file.
pub struct MeshWriter<'a> {
    format: Format,
    steps_per_unit: f64,
    unit: &'a str,
    triangles_max: u64,
    triangulator: Triangulator,
    triangles: u64,
    file: BufWriter<File>,
    /// Triangles by the numbers of their corners, where they cannot be written yet.
    beside: Option<BufWriter<File>>,
    vertices: Vec<[f64; 3]>,
    index: FxHashMap<[u64; 3], u32>,
}

impl<'a> MeshWriter<'a> {
    /// Begins a mesh of at most so many triangles, in user units of so many steps. `unit` is the user unit's label. Files come from
    /// `scratch`, empty.
    /// # Errors
    /// [`MeshError::Io`].
    pub fn new(
        format: Format,
        (steps_per_unit, unit): (f64, &'a str),
        triangles_max: Option<u64>,
        scratch: &dyn Fn() -> io::Result<File>,
    ) -> Result<Self, MeshError> {
        let mut file = BufWriter::with_capacity(1 << 18, scratch()?);
        let beside = match format {
            Format::Stl => {
                let text = format!("union3d, numbers of 32 bits, unit {unit}");
                let mut head = [b' '; STL_TEXT_BYTES];
                let text = text.as_bytes();
                let size = text.len().min(STL_TEXT_BYTES);
                head[..size].copy_from_slice(&text[..size]);
                file.write_all(&head)?;
                file.write_all(&[0; 4])?;
                None
            }
            Format::Obj => {
                let unit = unit.replace(char::is_control, " ");
                writeln!(file, "# union3d, unit {unit}")?;
                None
            }
            Format::Ply | Format::ThreeMf | Format::Glb => {
                Some(BufWriter::with_capacity(1 << 18, scratch()?))
            }
        };
        Ok(Self {
            format,
            steps_per_unit,
            unit,
            triangles_max: triangles_max.unwrap_or(u64::MAX).min(TRIANGLES_MAX),
            triangulator: Triangulator::default(),
            triangles: 0,
            file,
            beside,
            vertices: Vec::new(),
            index: FxHashMap::default(),
        })
    }

    /// Writes a face.
    /// # Errors
    /// [`MeshError`]: nothing is to be written after it.
    pub fn write(&mut self, face: &Face) -> Result<(), MeshError> {
        let mut triangulator = std::mem::take(&mut self.triangulator);
        let mut written = Ok(());
        triangulator.each(face, &mut |triangle| {
            if written.is_ok() {
                written = self.triangle(face, triangle);
            }
        });
        self.triangulator = triangulator;
        written
    }

    fn triangle(&mut self, face: &Face, triangle: Triangle) -> Result<(), MeshError> {
        let corners = triangle.map(|corner| {
            corner.map(|steps| {
                let length = steps / self.steps_per_unit;
                if self.format.is_narrow() {
                    f64::from(narrow(length))
                } else {
                    length
                }
            })
        });
        let [a, b, c] = corners.map(|corner| corner.map(|coordinate| (coordinate + 0.0).to_bits()));
        if a == b || b == c || c == a {
            return Ok(());
        }
        if self.triangles == self.triangles_max {
            let triangles_max = self.triangles_max;
            return Err(MeshError::TooMany { triangles_max });
        }
        self.triangles += 1;
        if self.format == Format::Stl {
            let mut record = [0; 50];
            let numbers = face.normal.iter().chain(corners.iter().flatten());
            for (at, number) in record.chunks_exact_mut(4).zip(numbers) {
                at.copy_from_slice(&narrow(*number).to_le_bytes());
            }
            self.file.write_all(&record)?;
            return Ok(());
        }
        let mut numbers = [0; 3];
        for (number, corner) in numbers.iter_mut().zip(corners) {
            *number = self.number(corner)?;
        }
        if let Some(beside) = &mut self.beside {
            for number in numbers {
                beside.write_all(&number.to_le_bytes())?;
            }
        } else {
            let [a, b, c] = numbers.map(|number| number + 1);
            writeln!(self.file, "f {a} {b} {c}")?;
        }
        Ok(())
    }

    /// The number of a vertex.
    fn number(&mut self, vertex: [f64; 3]) -> Result<u32, MeshError> {
        let vertex = vertex.map(|coordinate| coordinate + 0.0);
        let next = u32::try_from(self.index.len()).expect("there are 3 to a triangle at most");
        let number = *self.index.entry(vertex.map(f64::to_bits)).or_insert(next);
        if number == next {
            if self.format == Format::Obj {
                let [x, y, z] = vertex;
                writeln!(self.file, "v {x} {y} {z}")?;
            } else {
                self.vertices.push(vertex);
            }
        }
        Ok(number)
    }

    /// Ends the mesh: the file, from its beginning, its size in bytes, and how many triangles it has.
    /// # Errors
    /// [`MeshError::Io`].
    pub fn finish(mut self) -> Result<(File, u64, u64), MeshError> {
        self.index = FxHashMap::default();
        if let Some(beside) = self.beside.take() {
            let mut beside = beside
                .into_inner()
                .map_err(io::IntoInnerError::into_error)?;
            beside.rewind()?;
            let mut beside = BufReader::with_capacity(1 << 18, beside);
            match self.format {
                Format::Ply => self.write_ply(&mut beside)?,
                Format::Glb => self.write_glb(&mut beside)?,
                _ => self.write_3mf(&mut beside)?,
            }
        }
        let file = self.file.into_inner();
        let mut file = file.map_err(io::IntoInnerError::into_error)?;
        if self.format == Format::Stl {
            file.seek(SeekFrom::Start(STL_TEXT_BYTES as u64))?;
            let count = u32::try_from(self.triangles).expect("no more are taken");
            file.write_all(&count.to_le_bytes())?;
        }
        let size = file.seek(SeekFrom::End(0))?;
        file.rewind()?;
        Ok((file, size, self.triangles))
    }

    fn write_ply(&mut self, beside: &mut impl Read) -> io::Result<()> {
        let unit = self.unit.replace(char::is_control, " ");
        let (vertices, triangles) = (self.vertices.len(), self.triangles);
        write!(
            self.file,
            "ply\nformat binary_little_endian 1.0\ncomment union3d, unit {unit}\n\
             element vertex {vertices}\nproperty double x\nproperty double y\nproperty double z\n\
             element face {triangles}\nproperty list uchar int vertex_indices\nend_header\n"
        )?;
        for coordinate in self.vertices.iter().flatten() {
            self.file.write_all(&coordinate.to_le_bytes())?;
        }
        let mut record = [0; 12];
        for _ in 0..triangles {
            beside.read_exact(&mut record)?;
            self.file.write_all(&[3])?;
            self.file.write_all(&record)?;
        }
        Ok(())
    }

    fn write_glb(&mut self, beside: &mut impl Read) -> io::Result<()> {
        let (mut least, mut greatest) = ([0.0; 3], [0.0; 3]);
        for (count, vertex) in self.vertices.iter().enumerate() {
            for axis in 0..3 {
                let at = vertex[axis];
                least[axis] = if count == 0 { at } else { at.min(least[axis]) };
                greatest[axis] = if count == 0 {
                    at
                } else {
                    at.max(greatest[axis])
                };
            }
        }
        let (vertices, indices) = (self.vertices.len(), 3 * self.triangles);
        let (vertex_bytes, index_bytes) = (12 * vertices, 4 * indices);
        let size = vertex_bytes as u64 + index_bytes;
        let asset = json!({"version": "2.0", "generator": "union3d"});
        // A file without triangles has no mesh: an accessor has one element at least.
        let json = if self.triangles == 0 {
            json!({"asset": asset})
        } else {
            json!({
                "asset": asset,
                "scene": 0,
                "scenes": [{"nodes": [0]}],
                "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": 4}]}],
                "buffers": [{"byteLength": size}],
                "bufferViews": [
                    {"buffer": 0, "byteOffset": 0, "byteLength": vertex_bytes, "target": 34962},
                    {"buffer": 0, "byteOffset": vertex_bytes, "byteLength": index_bytes, "target": 34963},
                ],
                "accessors": [
                    {"bufferView": 0, "componentType": 5126, "count": vertices, "type": "VEC3", "min": least, "max": greatest},
                    {"bufferView": 1, "componentType": 5125, "count": indices, "type": "SCALAR"},
                ],
            })
        };
        let mut json = json.to_string();
        while json.len() % 4 != 0 {
            json.push(' ');
        }
        let binary = if size == 0 { 0 } else { 8 + size };
        let whole = 12 + 8 + json.len() as u64 + binary;
        let length = |size: u64| {
            let too_large = || io::Error::other("the mesh is larger than 4 GB, the most of GLB");
            u32::try_from(size).map_err(|_| too_large())
        };
        let file = &mut self.file;
        file.write_all(b"glTF")?;
        for number in [2, length(whole)?, length(json.len() as u64)?] {
            file.write_all(&number.to_le_bytes())?;
        }
        file.write_all(b"JSON")?;
        file.write_all(json.as_bytes())?;
        if size == 0 {
            return Ok(());
        }
        file.write_all(&length(size)?.to_le_bytes())?;
        file.write_all(b"BIN\0")?;
        for coordinate in self.vertices.iter().flatten() {
            file.write_all(&narrow(*coordinate).to_le_bytes())?;
        }
        io::copy(beside, file)?;
        Ok(())
    }

    fn write_3mf(&mut self, beside: &mut impl Read) -> io::Result<()> {
        const TYPES: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>"#;
        const RELATIONS: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>"#;
        let unit = match self.unit {
            "um" | "µm" | "μm" | "micron" => "micron",
            "cm" | "centimeter" | "centimetre" => "centimeter",
            "in" | "inch" | "inches" => "inch",
            "ft" | "foot" | "feet" => "foot",
            "m" | "meter" | "metre" => "meter",
            // The format knows no others.
            _ => "millimeter",
        };
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(1))
            .large_file(true);
        let mut zip = ZipWriter::new(&mut self.file);
        for (name, text) in [("[Content_Types].xml", TYPES), ("_rels/.rels", RELATIONS)] {
            zip.start_file(name, options)?;
            zip.write_all(text.as_bytes())?;
        }
        zip.start_file("3D/3dmodel.model", options)?;
        let mut xml = BufWriter::with_capacity(1 << 16, &mut zip);
        write!(
            xml,
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
             <model unit=\"{unit}\" xml:lang=\"en-US\" xmlns=\"http://schemas.microsoft.com/3dmanufacturing/core/2015/02\">\n\
             <resources><object id=\"1\" type=\"model\"><mesh><vertices>\n"
        )?;
        for [x, y, z] in &self.vertices {
            writeln!(xml, "<vertex x=\"{x}\" y=\"{y}\" z=\"{z}\"/>")?;
        }
        writeln!(xml, "</vertices><triangles>")?;
        let mut record = [[0; 4]; 3];
        for _ in 0..self.triangles {
            beside.read_exact(record.as_flattened_mut())?;
            let [a, b, c] = record.map(u32::from_le_bytes);
            writeln!(xml, "<triangle v1=\"{a}\" v2=\"{b}\" v3=\"{c}\"/>")?;
        }
        writeln!(
            xml,
            "</triangles></mesh></object></resources><build><item objectid=\"1\"/></build></model>"
        )?;
        xml.flush()?;
        drop(xml);
        zip.finish()?;
        Ok(())
    }
}

/// The nearest number of 32 bits.
#[expect(
    clippy::cast_possible_truncation,
    reason = "this is the rounding that the formats need; a coordinate is far below the greatest such number"
)]
fn narrow(number: f64) -> f32 {
    number as f32
}
