"""The mapper of the running service: a process that keeps keyframes and fuses them on command."""
