"""The contract between training and flight.

``observation`` says what the actor sees, ``action`` what it answers, ``actor`` how both travel
inside one ONNX file and when that file is refused.
"""
