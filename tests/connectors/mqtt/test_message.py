from connectors.mqtt.message import Message


def test_what_is_published_reaches_the_broker_and_stays_there_unless_it_says_otherwise() -> None:
    message = Message("a/b", b"x")
    assert (message.qos, message.retain) == (1, True)


def test_messages_are_the_same_if_they_say_the_same_in_the_same_way() -> None:
    message = Message("a/b", b"x", qos=0, retain=False)
    assert message == Message("a/b", b"x", 0, False)  # noqa: FBT003 - the fields' order is part of it
    assert len({message, Message("a/b", b"x"), Message("a/c", b"x"), Message("a/b", b"y")}) == 4
