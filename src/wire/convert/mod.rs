//! User units to lattice steps and back: the only place below the command line that knows floats.

mod derived;
mod mass_properties;
mod motion;
mod numbers;
mod settings;
#[cfg(test)]
mod tests;
mod units;
mod wanted;

pub(in crate::wire) use self::derived::float256;
pub use self::mass_properties::{
    EdgeLength, Exact, ExactEdgeLength, IntegerMeasures, MassProperties, PartProperties,
    UserBounds, UserMeasures, Vertices, mass_properties,
};
pub use self::motion::{DURATION_SECONDS_MAX, duration_ns, duration_user, removal_rate};
pub(in crate::wire) use self::numbers::{OFF_LATTICE_MAX, float, nearest, whole};
pub use self::settings::{Anchor, Rounding, Settings};
pub use self::units::InvalidCoordinate;
pub use self::wanted::{
    DENSITY_MAX, InvalidSetting, KindName, STEPS_PER_UNIT_MAX, SettingsDocument, StockDocument,
    UNIT_BYTES_MAX,
};
