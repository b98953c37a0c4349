//! User units to lattice steps and back: the only place below the command line that knows floats.

mod derived;
mod mass_properties;
mod motion;
mod settings;
#[cfg(test)]
mod tests;
mod units;

pub(in crate::wire) use self::derived::float256;
pub use self::mass_properties::{
    EdgeLength, Exact, ExactEdgeLength, IntegerMeasures, MassProperties, PartProperties,
    UserBounds, UserMeasures, Vertices, mass_properties,
};
pub use self::motion::{
    DURATION_SECONDS_MAX, Removal, duration_ns, duration_user, removal, removal_rate,
};
pub use self::settings::{
    Anchor, DENSITY_MAX, InvalidSetting, Rounding, STEPS_PER_UNIT_MAX, Settings, SettingsDocument,
    StockDocument, UNIT_BYTES_MAX,
};
pub use self::units::InvalidCoordinate;
pub(in crate::wire) use self::units::{OFF_LATTICE_MAX, float, nearest, whole};
