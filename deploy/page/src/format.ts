/** Numbers and units as people read them. */

const digits = new Intl.NumberFormat("en", { maximumSignificantDigits: 10 });
const short = new Intl.NumberFormat("en", { maximumSignificantDigits: 5 });
const whole = new Intl.NumberFormat("en", { maximumFractionDigits: 0 });

const narrow = (text: string): string => text.replaceAll(",", "\u202f").replace("-", "\u2212");
const tidy = (value: number, form: Intl.NumberFormat): string => {
    const size = Math.abs(value);
    if (size !== 0 && (size >= 1e12 || size < 1e-5)) return value.toExponential(4).replaceAll("-", "\u2212");
    return narrow(form.format(value));
};

export const number = (value: number): string => tidy(value, digits);
export const brief = (value: number): string => tidy(value, short);
export const count = (value: number): string => narrow(whole.format(value));

/** A unit to a power: mm³. */
export const unitTo = (unit: string, power: number): string => unit + (["", "", "²", "³", "⁴", "⁵"][power] ?? "");

/** A count with its noun. */
export const counted = (value: number, one: string, many = `${one}s`): string => `${count(value)} ${value === 1 ? one : many}`;

export function seconds(value: number): string {
    if (value < 60) return `${brief(value)} s`;
    const minutes = Math.floor(value / 60);
    if (minutes < 60) return `${minutes} min ${Math.floor(value % 60)} s`;
    return `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}
