"""A block on a plane, lit by exported light in the programs that receive it."""
