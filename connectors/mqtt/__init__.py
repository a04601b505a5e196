"""Slip events over MQTT 5: a sink with a durable outbox, and a consumer that fetches the events it missed."""
