"""Sensors as messages, and their readings out of messages: a codec for each kind of sensor."""
