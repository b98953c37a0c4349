//! Figures from many measurements: medians, percentiles, rates.

use std::time::Duration;

/// How long single operations took.
#[derive(Clone, Debug, Default)]
pub(crate) struct Latencies {
    nanoseconds: Vec<u64>,
}

impl Latencies {
    /// Room for so many, so that no measurement pays for more.
    pub(crate) fn with_capacity(count: usize) -> Self {
        Self {
            nanoseconds: Vec::with_capacity(count),
        }
    }

    pub(crate) fn push(&mut self, latency: Duration) {
        let nanoseconds = u64::try_from(latency.as_nanos()).unwrap_or(u64::MAX);
        self.nanoseconds.push(nanoseconds);
    }

    pub(crate) fn extend(&mut self, others: &Self) {
        self.nanoseconds.extend_from_slice(&others.nanoseconds);
    }

    pub(crate) fn len(&self) -> usize {
        self.nanoseconds.len()
    }

    /// All together.
    pub(crate) fn sum(&self) -> Duration {
        Duration::from_nanos(self.nanoseconds.iter().sum())
    }

    /// The p50, p99, p99.9 and greatest. Units: microseconds. Zero when there are none.
    pub(crate) fn spread(mut self) -> Spread {
        self.nanoseconds.sort_unstable();
        let at = |permille: usize| {
            // The least latency that so many of a thousand do not exceed.
            let rank = (self.nanoseconds.len() * permille).div_ceil(1000).max(1);
            let found = self.nanoseconds.get(rank - 1).copied().unwrap_or(0);
            float(found) / 1e3
        };
        Spread {
            p50: at(500),
            p99: at(990),
            p999: at(999),
            max: at(1000),
        }
    }
}

/// Percentiles of latencies. Units: microseconds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spread {
    pub(crate) p50: f64,
    pub(crate) p99: f64,
    pub(crate) p999: f64,
    pub(crate) max: f64,
}

impl Spread {
    /// The medians of each over several runs.
    pub(crate) fn median_of(runs: &[Self]) -> Self {
        let of = |part: fn(&Self) -> f64| median(runs.iter().map(part));
        Self {
            p50: of(|run| run.p50),
            p99: of(|run| run.p99),
            p999: of(|run| run.p999),
            max: of(|run| run.max),
        }
    }
}

/// The middle one, or the mean of the two in the middle. NaN of none.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_unstable_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => f64::NAN,
        odd if odd % 2 == 1 => values[middle],
        _ => f64::midpoint(values[middle - 1], values[middle]),
    }
}

/// How many in a second.
pub(crate) fn rate(count: usize, time: Duration) -> f64 {
    float(count as u64) / time.as_secs_f64()
}

/// A count as a float.
#[expect(
    clippy::cast_precision_loss,
    reason = "a figure of a benchmark does not need 53 bits"
)]
pub(crate) fn float(count: u64) -> f64 {
    count as f64
}

/// An exact measure as a float.
#[expect(
    clippy::cast_precision_loss,
    reason = "a figure of a benchmark does not need 53 bits"
)]
pub(crate) fn float_of_wide(measure: i128) -> f64 {
    measure as f64
}

/// A number of things: `1000`, `10k`, `20M`.
pub(crate) fn parse_count(text: &str) -> Result<usize, String> {
    let (digits, factor) = match text.as_bytes().last() {
        Some(b'k' | b'K') => (&text[..text.len() - 1], 1_000),
        Some(b'M') => (&text[..text.len() - 1], 1_000_000),
        _ => (text, 1),
    };
    let number: usize = digits
        .parse()
        .map_err(|_| "it is no whole number (such as 1000, 10k or 20M)".to_owned())?;
    match number.checked_mul(factor) {
        Some(0) => Err("it must be more than 0".to_owned()),
        Some(count) if count as u64 <= union3d::geometry::CUBES_MAX => Ok(count),
        _ => Err(format!("the most is {}", union3d::geometry::CUBES_MAX)),
    }
}

/// A round number as people write it: `20M`, `10k`.
pub(crate) fn short(count: usize) -> String {
    match count {
        millions if millions.is_multiple_of(1_000_000) => format!("{}M", millions / 1_000_000),
        thousands if thousands.is_multiple_of(1_000) => format!("{}k", thousands / 1_000),
        few => few.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_what_happened() {
        let mut latencies = Latencies::default();
        for microseconds in (1..=1000).rev() {
            latencies.push(Duration::from_micros(microseconds));
        }
        let Spread {
            p50,
            p99,
            p999,
            max,
        } = latencies.spread();
        assert_eq!([p50, p99, p999, max], [500.0, 990.0, 999.0, 1000.0]);
        let mut one = Latencies::default();
        one.push(Duration::from_micros(7));
        assert_eq!(one.spread().p50, 7.0);
        assert_eq!(Latencies::default().spread().max, 0.0);
    }

    #[test]
    fn the_median_is_the_middle() {
        assert_eq!(median([3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median([4.0, 1.0]), 2.5);
        assert!(median([]).is_nan());
    }

    #[test]
    fn counts_have_short_forms() {
        assert_eq!(parse_count("20M"), Ok(20_000_000));
        assert_eq!(parse_count("10k"), Ok(10_000));
        assert_eq!(parse_count("7"), Ok(7));
        for wrong in ["", "k", "-1", "1.5M", "0", "3000M"] {
            assert!(parse_count(wrong).is_err(), "{wrong}");
        }
    }
}
