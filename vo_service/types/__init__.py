"""What the service's parts exchange: estimates, updates, commands, messages, protocols of outputs.

Every part may import this package; it imports none of them.
"""
