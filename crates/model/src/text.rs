//! What names have in common, and what is written in JSON as text.

/// Names are a checked text: the check, and the error for any other text.
macro_rules! names {
    ($($name:ident: $valid:expr, else $error:ident by $wrong:expr;)*) => {$(
        impl $name {
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl ::std::fmt::Display for $name {
            fn fmt(&self, formatter: &mut ::std::fmt::Formatter<'_>) -> ::std::fmt::Result {
                formatter.write_str(&self.0)
            }
        }

        impl ::std::str::FromStr for $name {
            type Err = $error;

            fn from_str(text: &str) -> Result<Self, $error> {
                let (valid, wrong): (fn(&str) -> bool, fn(&str) -> $error) = ($valid, $wrong);
                if valid(text) { Ok(Self(text.to_owned())) } else { Err(wrong(text)) }
            }
        }

        impl $crate::wire::Wire for $name {
            fn put(&self, out: &mut Vec<u8>) {
                $crate::wire::put_text(out, &self.0);
            }

            fn read(
                reader: &mut $crate::wire::Reader<'_>,
                field: &'static str,
            ) -> Result<Self, $crate::wire::WireError> {
                reader.text(field)?.parse().map_err(|_| $crate::wire::WireError::Value(field))
            }
        }
    )*};
}

/// Whether a text has 1 to `most` bytes that fit, of which the first may begin it.
pub(crate) fn is_name(text: &str, most: usize, begins: impl Fn(u8) -> bool, fits: impl Fn(u8) -> bool) -> bool {
    text.len() <= most && text.bytes().next().is_some_and(begins) && text.bytes().all(fits)
}

macro_rules! as_text {
    ($($name:ident),*) => {$(
        impl ::serde::Serialize for $name {
            fn serialize<S: ::serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }

        impl<'de> ::serde::Deserialize<'de> for $name {
            fn deserialize<D: ::serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let text = <String as ::serde::Deserialize>::deserialize(deserializer)?;
                text.parse().map_err(::serde::de::Error::custom)
            }
        }
    )*};
}

pub(crate) use {as_text, names};

/// Gives each type `word()`: what `strum::IntoStaticStr` calls a value in texts and formats.
#[macro_export]
macro_rules! words {
    ($($name:ty),+) => {$(
        impl $name {
            /// What texts and formats call it.
            pub fn word(self) -> &'static str {
                self.into()
            }
        }
    )+};
}
