"""The platform at rest: statics, tensions, stability and natural modes."""
