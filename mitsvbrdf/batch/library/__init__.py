"""What a library holds: rows for people and pandas, the page that shows them, and words that choose among
them.
"""
