"""A scene prepared for one camera and its lights."""
