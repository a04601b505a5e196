"""Slip events over MQTT 5: an outbox that loses none, a consumer that asks for what it missed."""
